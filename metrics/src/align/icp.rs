//! Point-to-point ICP with scale, as Open3D's `registration_icp` runs it.

use super::transformed;
use super::umeyama::{Moments, Scale, umeyama};
use crate::distance::{
    BlockIndex, Coordinate, Listed, NearestIndex, Order, Source, Tracker, listed, squared_distance,
};
use crate::error::{Error, Result};
use glam::{DMat4, DVec3};

/// When ICP pairs points and when it stops.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct IcpOptions {
    /// Points further apart than this, in world units, are no pair. Above 0.
    pub max_distance: f64,
    /// Stop when the fitness changes by less than this, and
    pub relative_fitness: f64,
    /// the RMSE of the pairs, in world units, by less than this.
    pub relative_rmse: f64,
    /// Updates at most.
    pub max_iterations: usize,
    /// How each update may change the size.
    pub scale: Scale,
}

impl IcpOptions {
    /// Open3D's own criteria: 1e-6, 1e-6, 30 updates, each with Umeyama's scale.
    pub fn new(max_distance: f64) -> Self {
        Self {
            max_distance,
            relative_fitness: 1e-6,
            relative_rmse: 1e-6,
            max_iterations: 30,
            scale: Scale::Free,
        }
    }
}

/// How well the moved source lies on the target, and the motion found.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Icp {
    /// The similarity that moves the source onto the target.
    pub target_from_source: DMat4,
    /// Pairs over source points, in [0, 1].
    pub fitness: f64,
    /// Root of the mean squared distance of the pairs, in world units; 0 without pairs.
    pub inlier_rmse: f64,
    /// Pairs closer than the maximal distance.
    pub pairs: usize,
    /// Updates made.
    pub iterations: usize,
    /// Whether the last update changed fitness and RMSE by less than the criteria.
    pub converged: bool,
}

/// Moves `source` onto `target` by similarities, starting from where it is. The same bits at any
/// number of threads. Without any pair the result is the identity with fitness 0.
///
/// # Errors
/// Either cloud empty or not finite, a target of more than 2³² − 2 points, a maximal distance that is not finite and
/// above 0, and pairs of an update that coincide so that no scale fits, or lie so far out (from about 1e77) that
/// their products overflow.
pub fn icp(source: &[DVec3], target: &[DVec3], options: &IcpOptions) -> Result<Icp> {
    let source = listed(source, Order::Any);
    check(&source, options)?;
    icp_onto(&BlockIndex::new(target)?, Source::of(&source), options)
}

/// As [`icp`], onto a target that has an index already.
///
/// # Errors
/// No source points, and a maximal distance or pairs of an update that [`icp`] refuses.
pub fn icp_onto<C: Coordinate>(
    target: &BlockIndex<C>,
    source: Source,
    options: &IcpOptions,
) -> Result<Icp> {
    check_count(source.len())?;
    check_options(options)?;
    let mut tracker = Tracker::new(target, source, options.max_distance);
    let (centre, asked) = (tracker.centre(), tracker.len());
    let pair = |motion| {
        let sums = tracker.moved(motion);
        let update = || match sums.pairs {
            0 => Ok(DMat4::IDENTITY),
            _ => Moments::of_sums(&sums, centre).solve(options.scale),
        };
        (Paired::of(sums.pairs, sums.squares, asked), update())
    };
    iterate(pair, options)
}

/// As [`icp`], by kiddo's tree and plain loops: the oracle.
///
/// # Errors
/// As [`icp`] and [`NearestIndex::new`].
pub fn icp_plain(source: &[DVec3], target: &[DVec3], options: &IcpOptions) -> Result<Icp> {
    check(&listed(source, Order::Any), options)?;
    let index = NearestIndex::new(target)?;
    let mut moved = source.to_vec();
    let pair = |motion| {
        moved = transformed(&moved, motion);
        let (source, target, squares) = pairs(&moved, &index, options.max_distance);
        let update = match source.len() {
            0 => Ok(DMat4::IDENTITY),
            _ => umeyama(&source, &target, options.scale),
        };
        (Paired::of(source.len(), squares, moved.len()), update)
    };
    iterate(pair, options)
}

/// How well the clouds pair.
struct Paired {
    fitness: f64,
    inlier_rmse: f64,
    pairs: usize,
}

impl Paired {
    fn of(pairs: usize, squares: f64, asked: usize) -> Self {
        Self {
            fitness: pairs as f64 / asked as f64,
            inlier_rmse: (squares / pairs.max(1) as f64).sqrt(),
            pairs,
        }
    }
}

/// Moves and pairs until the criteria are met. `pair` moves the source and says how well it lies
/// then, and which motion would be the next.
fn iterate(
    mut pair: impl FnMut(DMat4) -> (Paired, Result<DMat4>),
    options: &IcpOptions,
) -> Result<Icp> {
    let (mut before, mut update) = pair(DMat4::IDENTITY);
    let (mut motion, mut iterations, mut converged) = (DMat4::IDENTITY, 0, false);
    while iterations < options.max_iterations && !converged {
        let step = update?;
        motion = step * motion;
        if !motion.is_finite() {
            let problem = "expected points whose products are finite, found overflow";
            return Err(Error::invalid("ICP", problem));
        }
        let (after, next) = pair(step);
        converged = close(&before, &after, options);
        (before, update) = (after, next);
        iterations += 1;
    }
    Ok(Icp {
        target_from_source: motion,
        fitness: before.fitness,
        inlier_rmse: before.inlier_rmse,
        pairs: before.pairs,
        iterations,
        converged,
    })
}

fn close(before: &Paired, after: &Paired, options: &IcpOptions) -> bool {
    (before.fitness - after.fitness).abs() < options.relative_fitness
        && (before.inlier_rmse - after.inlier_rmse).abs() < options.relative_rmse
}

fn check(source: &Listed<impl Fn(usize) -> DVec3>, options: &IcpOptions) -> Result<()> {
    check_count(source.count)?;
    if let Some(index) = (0..source.count).find(|&index| !(source.at)(index).is_finite()) {
        let problem = format!(
            "expected finite source points, found {} at {index}",
            (source.at)(index)
        );
        return Err(Error::invalid("ICP", problem));
    }
    check_options(options)
}

fn check_count(count: usize) -> Result<()> {
    if count == 0 {
        return Err(Error::invalid("ICP", "expected source points, found none"));
    }
    Ok(())
}

fn check_options(options: &IcpOptions) -> Result<()> {
    if !(options.max_distance.is_finite() && options.max_distance > 0.0) {
        let found = options.max_distance;
        let problem = format!("expected a finite maximal distance above 0, found {found}");
        return Err(Error::invalid("ICP", problem));
    }
    Ok(())
}

/// The source points that have a target point near enough, the targets, and Σ of squared distances.
fn pairs(
    moved: &[DVec3],
    index: &NearestIndex,
    max_distance: f64,
) -> (Vec<DVec3>, Vec<DVec3>, f64) {
    let (mut source, mut target, mut squares) = (Vec::new(), Vec::new(), 0.0);
    for &point in moved {
        let nearest = index.points()[index.nearest(point).0];
        let square = squared_distance(point, nearest);
        if square < max_distance * max_distance {
            source.push(point);
            target.push(nearest);
            squares += square;
        }
    }
    (source, target, squares)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::align::tests::scattered;
    use crate::align::umeyama::tests::similarity;

    #[test]
    fn a_small_motion_is_undone() {
        let target = scattered(7, 2000);
        let truth = similarity(1.01, 0.01, DVec3::new(0.01, -0.005, 0.0));
        let source = transformed(&target, truth.inverse());
        let options = IcpOptions {
            relative_fitness: 1e-12,
            relative_rmse: 1e-12,
            max_iterations: 200,
            ..IcpOptions::new(0.2)
        };
        let found = icp(&source, &target, &options).unwrap();
        assert!(found.converged && found.pairs == 2000 && found.fitness == 1.0);
        assert!(found.target_from_source.abs_diff_eq(truth, 1e-12));
        assert!(found.inlier_rmse < 1e-12);
    }

    /// A noisy smooth sheet tells no scale: every update that fits in the frame of the target takes
    /// off its share of noise, and the next one does so again.
    #[test]
    fn noise_of_the_source_shrinks_it_unless_the_fit_is_in_its_frame() {
        let target = sheet(20, 8000);
        let lift = scattered(21, 4000);
        let source: Vec<DVec3> = sheet(22, 4000)
            .iter()
            .zip(&lift)
            .map(|(p, n)| *p + DVec3::Z * (0.2 * n.x))
            .collect();
        let scale_by = |scale| {
            let options = IcpOptions {
                relative_fitness: 1e-9,
                relative_rmse: 1e-9,
                max_iterations: 60,
                scale,
                ..IcpOptions::new(0.5)
            };
            let found = icp(&source, &target, &options).unwrap();
            let plain = icp_plain(&source, &target, &options).unwrap();
            let same = found
                .target_from_source
                .abs_diff_eq(plain.target_from_source, 1e-9);
            assert!(same && found.iterations == plain.iterations);
            glam::DMat3::from_mat4(found.target_from_source)
                .determinant()
                .cbrt()
        };
        let (free, in_source) = (scale_by(Scale::Free), scale_by(Scale::FreeInSource));
        assert!(free < 0.93, "{free}");
        assert!((in_source - 1.0).abs() < 0.01, "{in_source}");
    }

    /// A bumpy sheet.
    fn sheet(seed: u64, count: u64) -> Vec<DVec3> {
        let bump = |p: &DVec3| DVec3::new(p.x, p.y, 0.3 * p.x * p.x - 0.2 * p.x * p.y);
        scattered(seed, count).iter().map(bump).collect()
    }

    #[test]
    fn every_step_is_the_oracles() {
        let mut target = sheet(40, 6000);
        // Twins, and a last block that is not full: as near as the partner, and no reason to lose it.
        target.extend_from_within(..101);
        let start = similarity(1.03, 0.04, DVec3::new(0.03, -0.02, 0.01));
        let mut source = transformed(&sheet(41, 5003), start);
        source.retain(|point| point.x < 0.7);
        source.extend(scattered(42, 200));
        for max_distance in [2.0, 0.2, 0.05, 0.01] {
            for max_iterations in [0, 1, 2, 3, 5, 8, 13, 40] {
                let options = IcpOptions {
                    max_iterations,
                    relative_fitness: 1e-9,
                    relative_rmse: 1e-9,
                    ..IcpOptions::new(max_distance)
                };
                let fast = icp(&source, &target, &options).unwrap();
                let plain = icp_plain(&source, &target, &options).unwrap();
                assert_eq!(
                    (fast.pairs, fast.iterations),
                    (plain.pairs, plain.iterations)
                );
                assert_eq!(
                    (fast.fitness, fast.converged),
                    (plain.fitness, plain.converged)
                );
                assert!((fast.inlier_rmse - plain.inlier_rmse).abs() < 1e-13);
                let (fast, plain) = (fast.target_from_source, plain.target_from_source);
                assert!(
                    fast.abs_diff_eq(plain, 1e-11),
                    "{max_distance} {max_iterations}"
                );
            }
        }
    }

    #[test]
    fn the_same_bits_at_any_number_of_threads() {
        let (source, target) = (sheet(43, 20_000), sheet(44, 20_000));
        let run = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads);
            let pool = pool.build().unwrap();
            pool.install(|| icp(&source, &target, &IcpOptions::new(0.1)).unwrap())
        };
        assert_eq!(run(1), run(3));
    }

    #[test]
    fn clouds_without_pairs_stay_where_they_are() {
        let source = scattered(8, 100);
        let target: Vec<DVec3> = source.iter().map(|p| *p + DVec3::X * 100.0).collect();
        let found = icp(&source, &target, &IcpOptions::new(0.1)).unwrap();
        assert_eq!(found.target_from_source, DMat4::IDENTITY);
        assert_eq!(
            (found.fitness, found.inlier_rmse, found.pairs),
            (0.0, 0.0, 0)
        );
    }

    /// Five pairs far out beside a sheet that is moved.
    #[test]
    fn pairs_far_out_give_a_finite_motion_or_an_error() {
        let moved: Vec<DVec3> = sheet(45, 2000)
            .iter()
            .map(|p| *p + DVec3::Z * 0.04)
            .collect();
        for exponent in (3..155).step_by(4).chain([160, 200, 300]) {
            let far = scattered(46, 5);
            let far = || far.iter().map(|p| *p * 10f64.powi(exponent));
            let target: Vec<DVec3> = sheet(45, 2000).into_iter().chain(far()).collect();
            let source: Vec<DVec3> = moved.iter().copied().chain(far()).collect();
            for scale in [Scale::One, Scale::Free, Scale::FreeInSource] {
                let options = IcpOptions {
                    scale,
                    max_iterations: 4,
                    ..IcpOptions::new(0.05)
                };
                if let Ok(found) = icp(&source, &target, &options) {
                    assert!(found.target_from_source.is_finite(), "{exponent} {scale:?}");
                }
            }
        }
    }

    #[test]
    fn a_pair_at_exactly_the_maximal_distance_is_none() {
        let found = icp(&[DVec3::X], &[DVec3::ZERO], &IcpOptions::new(1.0)).unwrap();
        assert_eq!(found.pairs, 0);
    }

    #[test]
    fn bad_input_is_refused() {
        let points = scattered(9, 10);
        let options = IcpOptions::new(1.0);
        assert!(icp(&[], &points, &options).is_err());
        assert!(icp(&points, &[], &options).is_err());
        assert!(icp(&[DVec3::NAN], &points, &options).is_err());
        assert!(icp(&points, &points, &IcpOptions::new(0.0)).is_err());
    }
}
