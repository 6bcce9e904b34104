use super::*;
use crate::fuse::Estimate;
use crate::fuse::samples::{Grid, Unit};
use crate::fuse::testing::{Plane, arc, spoil};
use glam::DVec3;
use pulp::Arch;

/// With all that is said kept, and where the block lies in each source.
fn complete(sources: &[Against<'_>]) -> Verdict {
    Verdict {
        footprints: sources.iter().map(|_| Footprint::new()).collect(),
        ..Verdict::new(sources, Kept::Positions)
    }
}

/// The consensus, bit by bit.
fn agreed(verdict: &Verdict) -> Vec<u32> {
    let Consensus {
        count,
        violations,
        delta,
        enough,
        ..
    } = &verdict.consensus;
    let mut bits: Vec<u32> = count.iter().chain(violations).copied().collect();
    bits.extend(delta.iter().map(|value| value.to_bits()));
    bits.extend(enough.iter().map(|&enough| u32::from(enough)));
    bits
}

/// What every source says, and the consensus, bit by bit.
fn bits(verdict: &Verdict) -> Vec<u32> {
    let mut bits = agreed(verdict);
    for (seen, footprint) in verdict.seen.iter().zip(&verdict.footprints) {
        let columns = [&seen.x, &seen.y, &footprint.z, &seen.ratio, &seen.delta];
        bits.extend(columns.into_iter().flatten().map(|value| value.to_bits()));
        bits.extend(seen.agrees);
    }
    bits
}

/// What one source says about one pixel.
struct Said {
    sampled: bool,
    /// Expected depth / depth of the nearest pixel; 0 for none.
    near: f64,
    q: f32,
    delta: f32,
    /// Squares of the pixel error over its bound, and of the step of `dynamic`.
    within: f32,
    step2: f32,
    agrees: bool,
    close: bool,
}

/// The same arithmetic, source by source and pixel by pixel, as plainly as it can be said; where the block
/// lies in the source is taken as found.
fn say(court: &Court<'_>, block: &Block, verdict: &Verdict, (at, i): (usize, usize)) -> Said {
    let (source, bounds) = (&court.sources[at], &court.bounds);
    let footprint = &verdict.footprints[at];
    let z = footprint.z[i];
    let (first, stride) = (footprint.index[i] as usize, source.samples.stride());
    let taps = [first, first + 1, first + stride, first + stride + 1];
    let taps = taps.map(|place| source.samples.values()[place]);
    let (fx, fy) = (footprint.fx[i], footprint.fy[i]);
    let nearest = taps[usize::from(fx >= 0.5) + 2 * usize::from(fy >= 0.5)];
    let inverse = source.samples.unit() == Unit::Inverse;
    let over = |depth: f32| if depth > 0.0 { z / depth } else { 0.0 };
    let near = if inverse { nearest * z } else { over(nearest) };
    let (sampled, q) = match court.taps {
        Taps::Nearest => (near > 0.0, (1.0 - near) / near),
        Taps::Plain => {
            let [a, b, c, d] = taps;
            let (top, bottom) = (fx.mul_add(b - a, a), fx.mul_add(d - c, c));
            let depth = fy.mul_add(bottom - top, top);
            (
                depth > 0.0 && z > 0.0,
                depth.mul_add(footprint.inverse[i], -1.0),
            )
        }
        Taps::Valid(similar) => {
            let (gx, gy) = (1.0 - fx, 1.0 - fy);
            let shares = [gx * gy, fx * gy, gx * fy, fx * fy];
            let off = taps.map(|tap| tap.mul_add(z, -1.0));
            let pairs = || off.into_iter().zip(shares);
            let similar_ones = || pairs().filter(|(off, _)| off.abs() <= similar);
            let weight: f32 = similar_ones().map(|(_, share)| share).sum();
            let offset = similar_ones().fold(0.0, |sum, (off, share)| share.mul_add(off, sum));
            let counts = (near - 1.0).abs() <= similar;
            (counts, -offset / (weight + offset))
        }
    };
    let ([ex, ey, cz], depth) = (source.pair.epipole, block.depth[i]);
    let delta = q * (depth - cz);
    let (across_u, across_v) = (block.u[i].mul_add(cz, -ex), block.v[i].mul_add(cz, -ey));
    let across2 = q * q * across_u.mul_add(across_u, across_v * across_v);
    let reprojected2 = (depth + delta) * (depth + delta);
    let within = across2 / (bounds.pixel2 * reprojected2);
    let steps = delta * (1300.0 / depth).min(f32::MAX);
    let step2 = (16.0 * across2 / reprojected2).max(steps * steps);
    let two_way = |part: f32, square: f32| {
        let pixels = across2 < square * bounds.pixel2 * reprojected2;
        let tight = delta.abs() < part * bounds.tight * depth;
        sampled && (pixels || tight) && delta.abs() < part * bounds.relative * depth
    };
    let agrees = match court.rule {
        Rule::Disparity => sampled && source.disparity * (near - 1.0).abs() < z,
        Rule::Dynamic => sampled && step2 < 100.0,
        _ => two_way(1.0, 1.0),
    };
    Said {
        sampled,
        near: f64::from(near),
        q,
        delta: if sampled { delta } else { 0.0 },
        within,
        step2: if sampled { step2 } else { f32::INFINITY },
        agrees,
        close: agrees && two_way(0.5, 0.25),
    }
}

/// How the bounds are said to be: on the errors themselves, in f64. `None` where rounding may decide.
fn agrees_in_words(court: &Court<'_>, said: &Said, depth: f64) -> Option<bool> {
    let bounds = &court.bounds;
    let relative = f64::from(said.delta).abs() / depth;
    let ratios = [
        f64::from(said.within).sqrt(),
        relative / f64::from(bounds.tight),
        relative / f64::from(bounds.relative),
    ];
    if ratios.iter().any(|ratio| (ratio - 1.0).abs() < 1e-5) {
        return None;
    }
    let [pixels, tight, wide] = ratios.map(|ratio| ratio < 1.0);
    Some(said.sampled && (pixels || tight) && wide)
}

/// Holds a verdict to what is [`say`]id of each pixel and to the rules in words; how many pixels pass only
/// because nobody else can judge.
fn check_plainly(court: &Court<'_>, block: &Block, verdict: &Verdict) -> usize {
    let mut softened = 0;
    for i in 0..block.len {
        let said: Vec<Said> = (0..court.sources.len())
            .map(|at| say(court, block, verdict, (at, i)))
            .collect();
        for (said, seen) in said.iter().zip(&verdict.seen) {
            assert_eq!(seen.agrees[i], u32::from(said.agrees), "{:?}", court.rule);
            match court.rule {
                Rule::Disparity => assert_eq!(f64::from(seen.ratio[i]), said.near),
                _ => assert_eq!(seen.delta[i].to_bits(), said.delta.to_bits()),
            }
            if !matches!(court.rule, Rule::Disparity | Rule::Dynamic) {
                let words = agrees_in_words(court, said, f64::from(block.depth[i]));
                assert!(words.is_none_or(|words| words == said.agrees), "{}", said.q);
            }
        }
        let agreeing = || said.iter().filter(|said| said.agrees);
        let others = || {
            said.iter()
                .zip(&verdict.footprints)
                .filter(|(said, _)| !said.agrees)
        };
        let (count, bounds) = (agreeing().count() as u32, &court.bounds);
        assert_eq!(verdict.consensus.count[i], count);
        let through =
            |(said, _): &(&Said, _)| said.near > 0.0 && said.near < f64::from(bounds.through);
        let violations = others().filter(through).count() as u32;
        assert_eq!(verdict.consensus.violations[i], violations);
        if matches!(court.rule, Rule::Average | Rule::Dynamic) {
            let sum: f32 = agreeing()
                .map(|said| said.delta)
                .fold(0.0, |sum, delta| sum + delta);
            let mean = sum / (count + 1) as f32;
            assert_eq!(verdict.consensus.delta[i].to_bits(), mean.to_bits());
        }
        let close = said.iter().filter(|said| said.close);
        let nothing_there = others().filter(|(said, at)| at.z[i] > 0.0 && said.near == 0.0);
        let objects =
            others().any(|(said, _)| said.near > 0.0 && said.near <= f64::from(bounds.occluded));
        let suffice = close.count() >= 2 && nothing_there.count() <= 2 && !objects;
        let enough = match court.rule {
            Rule::Dynamic => (2..=10u16).any(|step| {
                let within = |said: &&Said| said.step2 < f32::from(step * step);
                said.iter().filter(within).count() >= usize::from(step)
            }),
            _ => count >= court.needed || (court.soften && suffice),
        };
        assert_eq!(verdict.consensus.enough[i], enough, "{:?}", court.rule);
        softened += usize::from(enough && count < court.needed);
    }
    softened
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
        block.push(Grid::whole(width), column, row, depth);
    }
    blocks
}

/// Checks that each source saw a block where it lies in that source, not in another; how many pixels those are.
fn are_where_f64_says(block: &Block, source: &Against<'_>, seen: &Seen) -> usize {
    let (mut exact, mut to) = (Seen::new(), Footprint::new());
    (source.pair).project_widely::<true>(block, source.samples, &mut exact, &mut to);
    let inner = |i: &usize| {
        let (x, y) = (exact.x[*i], exact.y[*i]);
        to.z[*i] > 0.0 && x.min(161.0 - x) > 0.01 && y.min(121.0 - y) > 0.01
    };
    let mut count = 0;
    for i in (0..block.len).filter(inner) {
        let off = (seen.x[i] - exact.x[i]).hypot(seen.y[i] - exact.y[i]);
        assert!(off < 2e-3, "{off}");
        count += 1;
    }
    count
}

#[test]
fn every_instruction_set_gives_the_same_bits() {
    let plane = Plane::tilted();
    let surface = |view: &View, pixel| plane.depth(view, pixel);
    // More sources than are set up abreast.
    let mut estimates = arc(2 + ABREAST, (160, 120), DVec3::ZERO, surface);
    for (index, estimate) in estimates.iter_mut().enumerate() {
        spoil(estimate, index as u64, 2e-3, 0.05, 12);
    }
    let own = &estimates[0];
    let (mut enough, mut softened, mut positions) = (0, 0, 0);
    for (rule, taps, unit) in [
        (Rule::Median, Taps::Valid(0.02), Unit::Inverse),
        (Rule::Average, Taps::Plain, Unit::Depth),
        (Rule::Keep, Taps::Valid(0.02), Unit::Inverse),
        (Rule::Dynamic, Taps::Plain, Unit::Depth),
        (Rule::Disparity, Taps::Nearest, Unit::Depth),
        (Rule::Disparity, Taps::Nearest, Unit::Inverse),
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
            kept: Kept::Positions,
            sources: &sources,
        };
        for block in &blocks(own) {
            let [mut plain, mut eight, mut wide] = [&sources; 3].map(|sources| complete(sources));
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
            for (source, seen) in sources.iter().zip(&wide.seen) {
                positions += are_where_f64_says(block, source, seen);
            }
            for kept in [Kept::Nothing, Kept::Words] {
                if (rule, kept) == (Rule::Median, Kept::Nothing) {
                    continue; // which sorts what is kept
                }
                let mut less = Verdict::new(&sources, kept);
                Arch::new().dispatch(Case {
                    court: Court { kept, ..court },
                    block,
                    verdict: &mut less,
                });
                assert!(agreed(&less) == agreed(&wide), "{rule:?} {kept:?}");
                if kept == Kept::Words {
                    for (kept, whole) in less.seen.iter().zip(&wide.seen) {
                        assert_eq!(kept.agrees, whole.agrees, "{rule:?}");
                        match rule {
                            Rule::Disparity => assert_eq!(kept.ratio, whole.ratio),
                            _ => assert_eq!(kept.delta, whole.delta, "{rule:?}"),
                        }
                    }
                }
            }
            let passed = check_plainly(&court, block, &wide);
            softened += if court.soften { passed } else { 0 };
            enough += wide.consensus.enough.iter().filter(|&&e| e).count();
        }
    }
    assert!(enough > 30_000 && softened > 100, "{enough} {softened}");
    assert!(positions > 200_000, "{positions}");
}

/// Counts by step are kept in bytes.
#[test]
fn more_sources_than_a_byte_counts_are_heard() {
    let plane = Plane::tilted();
    let estimates = arc(2, (80, 60), DVec3::ZERO, |view, pixel| {
        plane.depth(view, pixel)
    });
    let options = FuseOptions::default();
    let other = prepared((&estimates[0], &estimates[1]), Unit::Depth, &options);
    let source = Against {
        pair: &other.0,
        samples: &other.1,
        disparity: other.2,
    };
    let mut most = 0;
    for count in [255, 256, 600] {
        let sources = vec![source; count];
        let court = Court {
            rule: Rule::Dynamic,
            taps: Taps::Plain,
            bounds: Bounds::new(&estimates[0].view, &options),
            needed: 4,
            soften: false,
            kept: Kept::Positions,
            sources: &sources,
        };
        for block in &blocks(&estimates[0]) {
            let mut verdict = complete(&sources);
            Arch::new().dispatch(Case {
                court,
                block,
                verdict: &mut verdict,
            });
            check_plainly(&court, block, &verdict);
            most = most.max(verdict.consensus.count[0]);
        }
        assert_eq!(most, count as u32);
    }
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
    let surface = |view: &View, pixel| Plane::tilted().depth(view, pixel);
    let estimates = arc(2, (8, 6), DVec3::ZERO, surface);
    let options = FuseOptions::default();
    let (pair, samples, disparity) =
        &prepared((&estimates[0], &estimates[1]), Unit::Depth, &options);
    let source = Against {
        pair,
        samples,
        disparity: *disparity,
    };
    let sizes = [3, 4, 5, 8, 10, 13];
    for (sources, agreeing) in sizes.into_iter().flat_map(|n| (0..=n).map(move |k| (n, k))) {
        let mut verdict = complete(&vec![source; sources]);
        let mut wanted = Vec::new();
        for i in 0..BLOCK {
            let mut values = vec![0.0f32];
            for (at, source) in verdict.seen.iter_mut().enumerate() {
                // Which agree differs by pixel; what the others say must not matter.
                let value = ((at * 37 + i * 101) % 53) as f32 - 26.0;
                let agrees = (at + i) % sources < agreeing;
                source.delta[i] = value;
                source.agrees[i] = u32::from(agrees);
                verdict.consensus.count[i] += u32::from(agrees);
                values.extend(agrees.then_some(value));
            }
            values.sort_by(f32::total_cmp);
            wanted.push(values[(values.len() - 1) / 2]);
        }
        median(&verdict.seen, &mut verdict.sorted, &mut verdict.consensus);
        assert_eq!(
            verdict.consensus.delta.to_vec(),
            wanted,
            "{sources} {agreeing}"
        );
    }
}
