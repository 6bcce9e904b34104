//! What work costs. The only place in the library that reads a clock: nothing but `tradeoff`, whose
//! results are measurements, may use it.

use crate::error::Result;
use std::fs;
use std::time::Instant;

/// Work is repeated until a stretch of runs takes so much time, so that short work is not all noise.
const ENOUGH_SECONDS: f64 = 0.1;
const MOST_RUNS: u32 = 70;

/// The cost of one run.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Cost {
    /// CPU time of all threads in seconds, the median over the stretches of runs; wall-clock time where the
    /// system does not tell.
    pub(super) seconds: f64,
    /// The same of the fastest and the slowest stretch.
    pub(super) range: (f64, f64),
    /// The largest resident memory of the process in MiB during the runs, with all that it held
    /// before; `None` where the system does not tell.
    pub(super) peak_mib: Option<f64>,
}

/// Runs `work` in `stretches`, at least one; the last run's value and the cost of one run.
pub(super) fn measure<T>(stretches: u32, mut work: impl FnMut() -> Result<T>) -> Result<(T, Cost)> {
    #[allow(
        clippy::disallowed_methods,
        reason = "a switch of the kernel, not a result"
    )]
    let peak_is_reset = fs::write("/proc/self/clear_refs", "5").is_ok();
    let (mut value, first) = stretch(&mut work)?;
    let mut all = vec![first];
    for _ in 1..stretches {
        let (last, seconds) = stretch(&mut work)?;
        value = last;
        all.push(seconds);
    }
    all.sort_by(f64::total_cmp);
    let cost = Cost {
        seconds: 0.5 * (all[(all.len() - 1) / 2] + all[all.len() / 2]),
        range: (all[0], all[all.len() - 1]),
        peak_mib: peak_is_reset.then(peak_mib).flatten(),
    };
    Ok((value, cost))
}

/// Runs `work` until there is enough to measure; the last run's value and the seconds of one. The system
/// advances its account of CPU time in steps of some milliseconds, so it is read around all runs together.
fn stretch<T>(work: &mut impl FnMut() -> Result<T>) -> Result<(T, f64)> {
    let (wall, cpu) = (Instant::now(), cpu_seconds());
    let mut runs = 0;
    loop {
        let value = work()?;
        runs += 1;
        let elapsed = wall.elapsed().as_secs_f64();
        let spent = cpu.zip(cpu_seconds()).map(|(before, after)| after - before);
        let spent = spent.filter(|&seconds| seconds > 0.0).unwrap_or(elapsed);
        if spent >= ENOUGH_SECONDS || runs >= MOST_RUNS {
            return Ok((value, spent / f64::from(runs)));
        }
    }
}

/// Whether [`Cost::seconds`] is CPU time here.
pub(super) fn tells_cpu_time() -> bool {
    cpu_seconds().is_some()
}

/// CPU time of all living threads in seconds (Linux). Worker threads live as long as the process.
fn cpu_seconds() -> Option<f64> {
    let mut nanoseconds = 0.0;
    for task in fs::read_dir("/proc/self/task").ok()? {
        // A thread that ends in between takes its time with it.
        let Ok(text) = fs::read_to_string(task.ok()?.path().join("schedstat")) else {
            continue;
        };
        nanoseconds += text.split(' ').next()?.parse::<f64>().ok()?;
    }
    (nanoseconds > 0.0).then_some(nanoseconds * 1e-9)
}

fn peak_mib() -> Option<f64> {
    let status = fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|line| line.starts_with("VmHWM:"))?;
    let kib: f64 = line.split_whitespace().nth(1)?.parse().ok()?;
    Some(kib / 1024.0)
}
