use super::*;
use crate::fuse::Estimate;
use crate::fuse::samples::Unit;
use crate::fuse::testing::{Plane, arc, spoil};
use glam::DVec3;
use pulp::Arch;

/// What every source says, and the consensus, bit by bit.
fn bits(verdict: &Verdict) -> Vec<u32> {
    let Consensus {
        count,
        violations,
        delta,
        enough,
        witnesses: _,
    } = &verdict.consensus;
    let mut bits: Vec<u32> = count.iter().chain(violations).copied().collect();
    bits.extend(delta.iter().map(|value| value.to_bits()));
    bits.extend(enough.iter().map(|&enough| u32::from(enough)));
    for seen in &verdict.seen {
        let columns = [&seen.x, &seen.y, &seen.z, &seen.ratio, &seen.near];
        let more = [&seen.delta, &seen.pixel2, &seen.relative];
        let floats = columns.into_iter().chain(more).flatten();
        bits.extend(floats.map(|value| value.to_bits()));
        bits.extend(seen.agrees);
    }
    bits
}

fn prepared(
    (own, source): (&Estimate, &Estimate),
    unit: Unit,
    options: &FuseOptions,
) -> (Pair, Samples, f32) {
    let depths = source.depth.values().iter();
    let stored: Vec<f32> = depths.map(|&depth| unit.convert(depth)).collect();
    (
        Pair::new(&own.view, &source.view),
        Samples::new(source.depth.size(), unit, &stored),
        disparity_scale(&own.view, &source.view, options),
    )
}

/// Four that agree, or two that do closely and none that could object, pixel by pixel; how many
/// pass by the second.
fn check_softened(block: &Block, verdict: &Verdict, bounds: &Bounds) -> usize {
    let mut softened = 0;
    for i in 0..block.len {
        let (mut agreeing, mut close, mut silent, mut objects) = (0, 0, 0, false);
        for seen in &verdict.seen {
            let error = seen.relative[i];
            let half = error < bounds.relative / 2.0;
            let half_pixel = seen.pixel2[i].sqrt() < bounds.pixel2.sqrt() / 2.0;
            if seen.agrees[i] == 1 {
                agreeing += 1;
                close += usize::from(half && (half_pixel || error < bounds.tight / 2.0));
            } else if seen.z[i] > 0.0 {
                // Nothing there; or something, and not in front.
                silent += usize::from(seen.near[i] == 0.0);
                objects |= seen.near[i] > 0.0 && seen.near[i] <= 1.01;
            }
        }
        let suffice = close >= 2 && silent <= 2 && !objects;
        assert_eq!(verdict.consensus.enough[i], agreeing >= 4 || suffice);
        softened += usize::from(agreeing < 4 && suffice);
    }
    softened
}

/// All pixels of a map that have a depth, in blocks; the last may be short.
fn blocks(estimate: &Estimate) -> Vec<Block> {
    let mut blocks = vec![Block::new()];
    let (width, height) = estimate.depth.size();
    for (column, row) in (0..height).flat_map(|row| (0..width).map(move |c| (c, row))) {
        let depth = estimate.depth.get(column, row);
        if depth <= 0.0 {
            continue;
        }
        if blocks.last().unwrap().is_full() {
            blocks.push(Block::new());
        }
        let block = blocks.last_mut().unwrap();
        block.push(width, column, row, depth);
    }
    blocks
}

#[test]
fn every_instruction_set_gives_the_same_bits() {
    let plane = Plane::tilted();
    let surface = |view: &View, pixel| plane.depth(view, pixel);
    let mut estimates = arc(6, (160, 120), DVec3::ZERO, surface);
    for (index, estimate) in estimates.iter_mut().enumerate() {
        spoil(estimate, index as u64, 2e-3, 0.05, 12);
    }
    let own = &estimates[0];
    let (mut enough, mut softened) = (0, 0);
    for (rule, taps, unit) in [
        (Rule::Median, Taps::Valid(0.02), Unit::Inverse),
        (Rule::Average, Taps::Plain, Unit::Depth),
        (Rule::Keep, Taps::Valid(0.02), Unit::Inverse),
        (Rule::Dynamic, Taps::Plain, Unit::Depth),
        (Rule::Disparity, Taps::Nearest, Unit::Depth),
    ] {
        let options = FuseOptions::default();
        let others: Vec<(Pair, Samples, f32)> = estimates[1..]
            .iter()
            .map(|source| prepared((own, source), unit, &options))
            .collect();
        let sources: Vec<Against<'_>> = others
            .iter()
            .map(|(pair, samples, disparity)| Against {
                pair,
                samples,
                disparity: *disparity,
            })
            .collect();
        let court = Court {
            rule,
            taps,
            bounds: Bounds::new(&own.view, &options),
            needed: 4,
            soften: matches!(rule, Rule::Average | Rule::Keep),
            sources: &sources,
        };
        for block in &blocks(own) {
            let [mut plain, mut eight, mut wide] = [5; 3].map(Verdict::new);
            let case = |verdict| Case {
                court,
                block,
                verdict,
            };
            case(&mut plain).with_simd(pulp::Scalar::new());
            Arch::new().dispatch(case(&mut wide));
            by_avx2(case(&mut eight));
            assert!(bits(&plain) == bits(&wide), "{rule:?}");
            assert!(bits(&plain) == bits(&eight), "{rule:?} by AVX2");
            if court.soften {
                softened += check_softened(block, &wide, &court.bounds);
            }
            enough += wide.consensus.enough.iter().filter(|&&e| e).count();
        }
    }
    assert!(enough > 30_000 && softened > 100, "{enough} {softened}");
}

/// With AVX2 also where the machine has more; with what it has where it has less.
fn by_avx2<W: WithSimd>(work: W) -> W::Output {
    #[cfg(target_arch = "x86_64")]
    if let Some(avx2) = pulp::x86::V3::try_new() {
        return Simd::vectorize(avx2, work);
    }
    Arch::new().dispatch(work)
}

#[test]
fn the_median_is_the_middle_value_and_of_an_even_number_the_smaller_middle_one() {
    for agreeing in 0..14usize {
        let mut verdict = Verdict::new(13);
        let mut wanted = Vec::new();
        for i in 0..BLOCK {
            let mut values = vec![0.0f32];
            for (at, source) in verdict.seen.iter_mut().enumerate() {
                // Which agree differs by pixel; what the others say must not matter.
                let value = ((at * 37 + i * 101) % 53) as f32 - 26.0;
                let agrees = (at + i) % 13 < agreeing;
                source.delta[i] = value;
                source.agrees[i] = u32::from(agrees);
                verdict.consensus.count[i] += u32::from(agrees);
                values.extend(agrees.then_some(value));
            }
            values.sort_by(f32::total_cmp);
            wanted.push(values[(values.len() - 1) / 2]);
        }
        median(&verdict.seen, &mut verdict.sorted, &mut verdict.consensus);
        assert_eq!(verdict.consensus.delta.to_vec(), wanted, "{agreeing}");
    }
}
