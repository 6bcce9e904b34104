//! Which camera of the reconstruction is which camera of the reference, and how the two
//! trajectories lie on each other.

use super::tnt::{Profile, scale_of};
use crate::error::{Error, Result};
use glam::{DMat4, DVec3};
use mvs_datasets::format::log::{LogPose, Mapping};
use mvs_metrics::align::trajectory::{self, Rule, TrajectoryFit, TrajectoryOptions};
use mvs_metrics::stats;

/// Longer logs have a pose per video frame, says the toolbox.
const LONGEST_IMAGE_LOG: usize = 1600;
/// Shifts of the log that are tried, in poses, both ways.
const MAX_SHIFT: isize = 10;
/// A shift is believed when it leaves less than this fraction of the median residual.
const SHIFT_GAIN: f64 = 0.5;
/// Candidates per shift that is tried: a shift that fits, fits nearly always.
const SHIFT_CANDIDATES: usize = 500;

/// The two trajectories of a scoring, as read.
#[derive(Debug, Clone)]
pub struct Trajectories {
    /// The reconstruction's poses.
    pub given: Vec<LogPose>,
    /// The scene's reference poses.
    pub reference: Vec<LogPose>,
    /// Which video frame each reference pose is, where the scene is a video.
    pub mapping: Option<Mapping>,
    /// Whether the reconstruction's poses were put in the reference's order by their images' names.
    pub named: bool,
    /// From the frame of the reference poses to the frame of the truth.
    pub truth_from_reference: DMat4,
}

/// One camera seen in both trajectories.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Match {
    /// Its index in the reference.
    pub reference_index: usize,
    /// Its centre in the reconstruction's frame; the origin where unregistered.
    pub given: DVec3,
    /// Its centre in the frame of the truth.
    pub reference: DVec3,
    /// Whether both trajectories have a pose for it.
    pub registered: bool,
}

/// All matches, and what the lists looked like.
#[derive(Debug, Clone, PartialEq)]
pub struct Matches {
    /// In the order of the reference.
    pub matches: Vec<Match>,
    /// Poses of the reconstruction's log as it is.
    pub log: usize,
    /// Frames of the scene's video, where a mapping file told which poses to take.
    pub video_frames: Option<usize>,
    /// Poses of the reconstruction, after the mapping of a video log.
    pub given: usize,
    /// Poses of the reference.
    pub reference: usize,
    /// How they were matched.
    pub by: MatchedBy,
}

/// What told which camera is which.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum MatchedBy {
    /// The order of the poses, as in the toolbox.
    Order,
    /// The order, after picking the mapping file's frames from a video log.
    Mapping,
    /// The first number of each pose's line: the log skips images and says which.
    Number,
    /// The names of the images.
    Name,
}

impl Matches {
    /// How many cameras are registered in both trajectories.
    pub fn registered(&self) -> usize {
        self.matches.iter().filter(|m| m.registered).count()
    }

    /// The matches that `profile` aligns by: all of them, or those registered in both.
    pub fn used_by(&self, profile: Profile) -> Vec<Match> {
        let used = |m: &&Match| profile == Profile::Official || m.registered;
        self.matches.iter().filter(used).copied().collect()
    }
}

impl Trajectories {
    /// Says which pose is which.
    ///
    /// # Errors
    /// A video log without a mapping file, or with one that names frames which the log does not have.
    pub fn matches(&self, profile: Profile) -> Result<Matches> {
        let (given, by) = self.given_by_reference(profile)?;
        let pairs = self.reference.iter().enumerate();
        let matches = pairs.filter_map(|(index, reference)| {
            let pose = given.get(index).copied().flatten()?;
            let centre = reference.world_from_cam.w_axis.truncate();
            Some(Match {
                reference_index: index,
                given: pose.world_from_cam.w_axis.truncate(),
                reference: self.truth_from_reference.transform_point3(centre),
                registered: !pose.is_unregistered() && !reference.is_unregistered(),
            })
        });
        Ok(Matches {
            matches: matches.collect(),
            log: self.given.len(),
            video_frames: self
                .mapping
                .as_ref()
                .filter(|_| by == MatchedBy::Mapping)
                .map(|mapping| mapping.video_frames),
            given: given.iter().flatten().count(),
            reference: self.reference.len(),
            by,
        })
    }

    /// Per camera of the reference its pose in the reconstruction's log, if that has one.
    fn given_by_reference(&self, profile: Profile) -> Result<(Vec<Option<&LogPose>>, MatchedBy)> {
        if self.named {
            return Ok((self.given.iter().map(Some).collect(), MatchedBy::Name));
        }
        if let Some(mapping) = self.needed_mapping()? {
            let frame = |&(_, frame): &(usize, usize)| {
                let pose = frame.checked_sub(1).and_then(|index| self.given.get(index));
                pose.map(Some).ok_or_else(|| {
                    let problem = format!(
                        "expected a pose for every frame of the mapping file, found {} poses and \
                         frame {frame}: was the log made from another video?",
                        self.given.len()
                    );
                    Error::invalid("trajectory", problem)
                })
            };
            let given = mapping.frames.iter().map(frame).collect::<Result<_>>()?;
            return Ok((given, MatchedBy::Mapping));
        }
        if profile == Profile::Strict && self.is_numbered_with_gaps() {
            let mut given = vec![None; self.reference.len()];
            for pose in &self.given {
                if let Some(place) = index_of(pose).and_then(|index| given.get_mut(index)) {
                    *place = Some(pose);
                }
            }
            return Ok((given, MatchedBy::Number));
        }
        Ok((self.given.iter().map(Some).collect(), MatchedBy::Order))
    }

    /// The mapping file, where the log has a pose per video frame.
    fn needed_mapping(&self) -> Result<Option<&Mapping>> {
        let frames = self.given.len();
        let fits = |mapping: &&Mapping| {
            frames > LONGEST_IMAGE_LOG
                || frames == mapping.video_frames && frames != self.reference.len()
        };
        if let Some(mapping) = &self.mapping {
            return Ok(Some(mapping).filter(fits));
        }
        if frames > LONGEST_IMAGE_LOG && frames != self.reference.len() {
            let problem = format!(
                "expected at most {LONGEST_IMAGE_LOG} poses, found {frames}: a log with a pose per \
                 video frame needs the scene's mapping file <Scene>_mapping_reference.txt"
            );
            return Err(Error::invalid("trajectory", problem));
        }
        Ok(None)
    }

    /// Whether the log leaves images out and its lines still carry the images' numbers.
    fn is_numbered_with_gaps(&self) -> bool {
        let numbers: Option<Vec<usize>> = self.given.iter().map(index_of).collect();
        let Some(numbers) = numbers else {
            return false;
        };
        let last = numbers.last().copied().unwrap_or_default();
        numbers.len() < self.reference.len()
            && numbers.windows(2).all(|pair| pair[0] < pair[1])
            && last >= numbers.len()
            && last < self.reference.len()
    }
}

fn index_of(pose: &LogPose) -> Option<usize> {
    usize::try_from(pose.metadata[0]).ok()
}

/// How two trajectories lie on each other.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraFit {
    /// Which camera is which.
    pub matches: Matches,
    /// The similarity found; its residuals are those of [`Matches::used_by`] the profile.
    pub fit: TrajectoryFit,
    /// Cameras that came near their own reference, among those registered in both.
    pub inliers: usize,
    /// The median residual over the cameras registered in both, in units of the truth.
    pub median_residual: f64,
    /// The found scale over the one that the distances between cameras suggest.
    pub scale_ratio: f64,
    /// By how many poses the log seems shifted: 3 where its pose `i` is camera `i + 3`.
    pub shift: Option<isize>,
}

/// Aligns the trajectories by the rule of `profile` and looks for signs that the log is not what it
/// should be. `camera_distance` is how near centres must come, in units of the truth.
///
/// # Errors
/// As [`Trajectories::matches`]; fewer than three cameras to align by, centres that are not finite, a
/// `camera_distance` that is not finite and above 0, no motion that brings a camera near a reference, and, by the
/// strict rule, cameras near theirs that all coincide.
pub fn fit(
    trajectories: &Trajectories,
    profile: Profile,
    camera_distance: f64,
    seed: u64,
) -> Result<CameraFit> {
    let matches = trajectories.matches(profile)?;
    let rule = match profile {
        Profile::Official => Rule::Official,
        Profile::Strict => Rule::Strict,
    };
    let options = TrajectoryOptions {
        max_distance: camera_distance,
        ..TrajectoryOptions::new(rule, seed)
    };
    let used = matches.used_by(profile);
    let (given, reference) = sides(&used);
    let fit = trajectory::align(&given, &reference, &options)?;
    let registered: Vec<f64> = used
        .iter()
        .zip(&fit.residuals)
        .filter(|(m, _)| m.registered)
        .map(|(_, &residual)| residual)
        .collect();
    let median_residual = stats::median(&registered).unwrap_or(f64::INFINITY);
    let scale_ratio = scale_of(fit.target_from_source) / suggested_scale(&used).unwrap_or(f64::NAN);
    Ok(CameraFit {
        inliers: registered.iter().filter(|&&r| r < camera_distance).count(),
        shift: shift_of(&matches.matches, median_residual, camera_distance, seed),
        median_residual,
        scale_ratio,
        matches,
        fit,
    })
}

fn sides(matches: &[Match]) -> (Vec<DVec3>, Vec<DVec3>) {
    matches.iter().map(|m| (m.given, m.reference)).unzip()
}

/// The median ratio of distances between cameras half a trajectory apart: a scale that no single
/// bad pose can move. `None` where the cameras of a side coincide.
fn suggested_scale(used: &[Match]) -> Option<f64> {
    let registered: Vec<&Match> = used.iter().filter(|m| m.registered).collect();
    let half = registered.len() / 2;
    let pairs = registered.iter().zip(registered.iter().skip(half));
    let ratios = pairs.map(|(a, b)| a.reference.distance(b.reference) / a.given.distance(b.given));
    let ratios: Vec<f64> = ratios.filter(|r| r.is_finite() && *r > 0.0).collect();
    stats::median(&ratios)
}

/// The shift that brings most cameras near their references, and much nearer than none does.
fn shift_of(
    matches: &[Match],
    median_residual: f64,
    camera_distance: f64,
    seed: u64,
) -> Option<isize> {
    // Residuals this small leave nothing to explain.
    if median_residual < 1e-3 * camera_distance {
        return None;
    }
    let shifts = (-MAX_SHIFT..=MAX_SHIFT).filter(|&shift| shift != 0);
    let residuals = shifts.filter_map(|shift| {
        let residual = median_residual_at(matches, shift, camera_distance, seed)?;
        Some((shift, residual))
    });
    let (shift, residual) = residuals.min_by(|a, b| a.1.total_cmp(&b.1))?;
    // The best of twenty fits to another scene's log gains too, and brings no camera near.
    let fits = residual < camera_distance && residual < SHIFT_GAIN * median_residual;
    fits.then_some(shift)
}

fn median_residual_at(
    matches: &[Match],
    shift: isize,
    camera_distance: f64,
    seed: u64,
) -> Option<f64> {
    let shifted = matches.iter().enumerate().filter_map(|(index, own)| {
        let other = matches.get(index.checked_add_signed(shift)?)?;
        (own.registered && other.registered).then_some((own.given, other.reference))
    });
    let (given, reference): (Vec<_>, Vec<_>) = shifted.unzip();
    if 2 * given.len() < matches.len() {
        return None;
    }
    let options = TrajectoryOptions {
        max_distance: camera_distance,
        iterations: SHIFT_CANDIDATES,
        ..TrajectoryOptions::new(Rule::Strict, seed)
    };
    let fit = trajectory::align(&given, &reference, &options).ok()?;
    stats::median(&fit.residuals)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DQuat;

    /// `count` cameras on a rising, wobbling ring, and the similarity from them to the truth.
    fn ring(count: usize) -> (Vec<LogPose>, DMat4) {
        let pose = |index: usize| {
            let t = index as f64;
            let angle = 0.11 * t + 0.05 * (0.9 * t).sin();
            let centre = DVec3::new(angle.cos(), angle.sin(), 0.02 * t + 0.1 * (0.7 * t).cos());
            LogPose {
                metadata: [index as i64, index as i64, 0],
                world_from_cam: DMat4::from_rotation_translation(
                    DQuat::from_rotation_z(angle),
                    centre,
                ),
            }
        };
        let motion = DMat4::from_scale_rotation_translation(
            DVec3::splat(3.0),
            DQuat::from_rotation_x(0.4),
            DVec3::new(5.0, 6.0, 7.0),
        );
        ((0..count).map(pose).collect(), motion)
    }

    fn unregistered() -> LogPose {
        LogPose {
            metadata: [0, -1, 0],
            world_from_cam: DMat4::IDENTITY,
        }
    }

    fn trajectories(given: Vec<LogPose>) -> Trajectories {
        let (reference, truth_from_reference) = ring(60);
        Trajectories {
            given,
            reference,
            mapping: None,
            named: false,
            truth_from_reference,
        }
    }

    fn strict(trajectories: &Trajectories) -> CameraFit {
        fit(trajectories, Profile::Strict, 0.2, 0).unwrap()
    }

    #[test]
    fn a_right_log_fits_and_is_not_called_shifted() {
        let fit = strict(&trajectories(ring(60).0));
        assert_eq!(
            (fit.inliers, fit.shift, fit.matches.by),
            (60, None, MatchedBy::Order)
        );
        assert!(fit.median_residual < 1e-9 && (fit.scale_ratio - 1.0).abs() < 1e-9);
        assert!(fit.fit.target_from_source.abs_diff_eq(ring(60).1, 1e-9));
    }

    #[test]
    fn a_log_that_lost_its_first_poses_is_called_shifted() {
        for lost in [1, 3, 8] {
            let given = ring(60).0[lost..].to_vec();
            let renumbered = given.into_iter().enumerate().map(|(index, pose)| LogPose {
                metadata: [index as i64, 0, 0],
                ..pose
            });
            let fit = strict(&trajectories(renumbered.collect()));
            assert_eq!(fit.shift, Some(lost as isize));
            assert_eq!((fit.matches.given, fit.matches.reference), (60 - lost, 60));
        }
    }

    /// Poses in another order fit nowhere, and no shift is to blame.
    #[test]
    fn a_log_in_another_order_is_not_called_shifted() {
        let reference = ring(60).0;
        for step in [7, 11, 13, 17, 23, 29] {
            let given = (0..60).map(|index| reference[index * step % 60].clone());
            let renumbered = given.enumerate().map(|(index, pose)| LogPose {
                metadata: [index as i64, 0, 0],
                ..pose
            });
            let fit = strict(&trajectories(renumbered.collect()));
            assert!(fit.inliers < 36, "{step} {}", fit.inliers);
            assert_eq!(fit.shift, None, "{step}");
        }
    }

    #[test]
    fn a_log_that_skips_images_and_says_so_is_matched_by_number() {
        let mut given = ring(60).0;
        given.retain(|pose| pose.metadata[0] % 5 != 2);
        let fit = strict(&trajectories(given.clone()));
        assert_eq!((fit.inliers, fit.matches.by), (48, MatchedBy::Number));
        assert_eq!(fit.shift, None);
        // The toolbox pairs by order and does not notice.
        let official = trajectories(given).matches(Profile::Official).unwrap();
        assert_eq!(official.by, MatchedBy::Order);
    }

    #[test]
    fn unregistered_poses_are_dropped_by_the_strict_profile_only() {
        let mut given = ring(60).0;
        for index in (0..60).filter(|index| index % 5 < 3) {
            given[index] = unregistered();
        }
        let trajectories = trajectories(given);
        let fit = strict(&trajectories);
        assert_eq!((fit.matches.registered(), fit.inliers), (24, 24));
        assert!((fit.scale_ratio - 1.0).abs() < 1e-9);
        let official = trajectories.matches(Profile::Official).unwrap();
        assert_eq!(official.used_by(Profile::Official).len(), 60);
    }

    #[test]
    fn the_official_rule_collapses_the_scale_where_most_poses_are_unregistered() {
        let mut given = ring(60).0;
        for index in (0..60).filter(|index| index % 5 < 3) {
            given[index] = unregistered();
        }
        let fit = fit(&trajectories(given), Profile::Official, 0.2, 0).unwrap();
        assert!(fit.scale_ratio < 0.8, "{}", fit.scale_ratio);
        assert!(fit.inliers < 12, "{}", fit.inliers);
    }

    #[test]
    fn a_video_log_is_thinned_by_its_mapping() {
        let (reference, motion) = ring(60);
        let frames: Vec<(usize, usize)> = (0..60).map(|image| (image, 1 + 30 * image)).collect();
        let mut given = vec![unregistered(); 1800];
        for (image, frame) in &frames {
            given[frame - 1] = reference[*image].clone();
        }
        let mut trajectories = Trajectories {
            given,
            reference,
            mapping: None,
            named: false,
            truth_from_reference: motion,
        };
        let error = trajectories.matches(Profile::Strict).unwrap_err();
        assert!(error.to_string().contains("mapping file"), "{error}");
        let mut mapping = Mapping {
            video_frames: 1800,
            frames,
        };
        trajectories.mapping = Some(mapping.clone());
        let fit = strict(&trajectories);
        assert_eq!((fit.inliers, fit.matches.by), (60, MatchedBy::Mapping));
        mapping.frames[59].1 = 1801;
        trajectories.mapping = Some(mapping);
        let error = trajectories.matches(Profile::Strict).unwrap_err();
        assert!(error.to_string().contains("frame 1801"), "{error}");
    }
}
