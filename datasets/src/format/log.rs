//! Tanks and Temples trajectories: `.log` files and video mapping files.

use super::text::Words;
use crate::error::FormatError;
use glam::DMat4;
use std::io::Write;

/// One pose of a `.log`.
#[derive(Debug, Clone, PartialEq)]
pub struct LogPose {
    /// The three integers before the matrix.
    pub metadata: [i64; 3],
    /// Camera-to-world.
    pub world_from_cam: DMat4,
}

impl LogPose {
    /// Whether the toolbox's converter marked this image as not registered: an identity matrix with
    /// −1 as second integer.
    pub fn is_unregistered(&self) -> bool {
        self.metadata[1] == -1 && self.world_from_cam == DMat4::IDENTITY
    }
}

/// A mapping file: which video frame each sampled image is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Mapping {
    /// Number of frames of the video.
    pub video_frames: usize,
    /// (image id, video frame id) as in the file. Video frames count from 1, in ascending order;
    /// image ids count from 0 in the toolbox's own files and are used by nothing.
    pub frames: Vec<(usize, usize)>,
}

/// Reads a `.log`: per pose three integers and a 4×4 camera-to-world matrix.
///
/// # Errors
/// No poses, and a number that is missing, not whole among the three, or not finite in the matrix.
pub fn read(text: &str) -> Result<Vec<LogPose>, FormatError> {
    let mut words = Words::new(text, None);
    let mut poses = Vec::new();
    while !words.is_done() {
        poses.push(read_pose(&mut words, poses.len())?);
    }
    if poses.is_empty() {
        return Err(FormatError::new(
            "line 1",
            "expected three integers and a 4x4 matrix per pose, found an empty file",
        ));
    }
    Ok(poses)
}

fn read_pose(words: &mut Words<'_>, index: usize) -> Result<LogPose, FormatError> {
    let what = format!("pose {index}");
    let mut metadata = [0; 3];
    for (nth, number) in metadata.iter_mut().enumerate() {
        *number = words.integer(&format!("integer {} of the 3 of {what}", nth + 1))?;
    }
    let rows = words.numbers::<16>(&what)?;
    Ok(LogPose {
        metadata,
        world_from_cam: DMat4::from_cols_array(&rows).transpose(),
    })
}

/// Writes a `.log` with the shortest digits that read back to the same numbers.
///
/// # Errors
/// What writing to `out` brings.
pub fn write(out: &mut impl Write, poses: &[LogPose]) -> std::io::Result<()> {
    for pose in poses {
        let [first, second, third] = pose.metadata;
        writeln!(out, "{first} {second} {third}")?;
        super::transform::write(out, &pose.world_from_cam)?;
    }
    Ok(())
}

/// Reads a mapping file: the count of sampled images, the count of video frames, then per image its
/// id and its video frame.
///
/// # Errors
/// A number that is missing or not whole, video frames that are not ascending from 1 to their count, and another
/// count of images than the first line says.
pub fn read_mapping(text: &str) -> Result<Mapping, FormatError> {
    let mut words = Words::new(text, None);
    let images: usize = words.integer("the count of sampled images")?;
    let video_frames: usize = words.integer("the count of video frames")?;
    let mut frames: Vec<(usize, usize)> = Vec::new();
    while !words.is_done() {
        let place = words.place();
        let image = words.integer("an image id")?;
        let frame = words.integer("a video frame id")?;
        if frame == 0 || frame > video_frames {
            let problem = format!("expected a video frame from 1 to {video_frames}, found {frame}");
            return Err(FormatError::new(place, problem));
        }
        if frames.last().is_some_and(|&(_, before)| frame <= before) {
            let problem = format!("expected ascending video frames, found {frame} after them");
            return Err(FormatError::new(place, problem));
        }
        frames.push((image, frame));
    }
    if frames.len() != images {
        let problem = format!(
            "expected {images} images as the first line says, found {}",
            frames.len()
        );
        return Err(FormatError::new(words.place(), problem));
    }
    Ok(Mapping {
        video_frames,
        frames,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn pose() -> impl Strategy<Value = LogPose> {
        let number = proptest::num::f64::NORMAL | proptest::num::f64::ZERO;
        let metadata = proptest::array::uniform3(any::<i64>());
        (metadata, proptest::array::uniform16(number)).prop_map(|(metadata, numbers)| LogPose {
            metadata,
            world_from_cam: DMat4::from_cols_array(&numbers),
        })
    }

    proptest! {
        #[test]
        fn every_trajectory_reads_back(poses in proptest::collection::vec(pose(), 1..5)) {
            let mut text = Vec::new();
            write(&mut text, &poses).unwrap();
            prop_assert_eq!(read(std::str::from_utf8(&text).unwrap()).unwrap(), poses);
        }
    }

    #[test]
    fn unregistered_is_identity_with_minus_one() {
        let text = "3 -1 0\n1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n4 4 0\n1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n";
        let poses = read(text).unwrap();
        assert_eq!(poses[0].metadata, [3, -1, 0]);
        assert!(poses[0].is_unregistered() && !poses[1].is_unregistered());
    }

    #[test]
    fn broken_trajectories_are_said_with_line_and_pose() {
        for (text, expected) in [
            ("", "found an empty file"),
            (
                "0 0 0\n1 0 0 0\n0 1",
                "line 3 (end of the file): expected number 7 of the 16 of pose 0",
            ),
            ("0 0.5 0\n", "line 1: expected integer 2 of the 3 of pose 0"),
            (
                "0 0 0\n1 0 nan 0",
                "line 2: expected number 3 of the 16 of pose 0",
            ),
            ("ply\nformat", "line 1: expected integer 1"),
        ] {
            let error = read(text).unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
        }
    }

    #[test]
    fn mapping_counts_are_checked() {
        let mapping = read_mapping("2\n90\n0 1\n1 30\n").unwrap();
        assert_eq!(
            (mapping.video_frames, &mapping.frames[..]),
            (90, &[(0, 1), (1, 30)][..])
        );
        for (text, expected) in [
            ("", "expected the count of sampled images"),
            (
                "99999999999\n90\n0 1\n",
                "expected 99999999999 images as the first line says, found 1",
            ),
            (
                "1\n90\n0 91\n",
                "line 3: expected a video frame from 1 to 90, found 91",
            ),
            ("1\n90\n0 0\n", "line 3: expected a video frame from 1"),
            ("2\n90\n0 5\n1 5", "line 4: expected ascending video frames"),
            ("1\n90\n0", "expected a video frame id, found nothing more"),
            (
                "-1\n90\n",
                "expected the count of sampled images as a whole number",
            ),
        ] {
            let error = read_mapping(text).unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
        }
    }
}
