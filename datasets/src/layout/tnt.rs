//! A Tanks and Temples scene folder.

use super::numbers::number_of;
use super::{files, model};
use crate::error::{Error, FormatError, Result};
use crate::format::colmap::{self, ColmapImage};
use crate::format::log::{self, LogPose, Mapping};
use crate::scene::{CropVolume, Similarity};
use glam::{DMat4, DVec3};
use std::path::{Path, PathBuf};

/// τ of the training set in metres, as the toolbox's `setup.py` lists it.
const TOLERANCES: [(&str, f64); 7] = [
    ("Barn", 0.01),
    ("Caterpillar", 0.005),
    ("Church", 0.025),
    ("Courthouse", 0.025),
    ("Ignatius", 0.003),
    ("Meetingroom", 0.01),
    ("Truck", 0.005),
];

/// What follows the scene's name in the names of the four files that are needed.
const SUFFIXES: [&str; 4] = [".ply", ".json", "_COLMAP_SfM.log", "_trans.txt"];

/// The files of `D/<Scene>/`, found but not read.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TntFolder {
    /// The scene's name, the prefix of its files.
    pub name: String,
    /// `<Scene>.ply`, the laser scan.
    pub truth: PathBuf,
    /// `<Scene>.json`, the crop volume.
    pub crop: PathBuf,
    /// `<Scene>_COLMAP_SfM.log`, the reference trajectory.
    pub trajectory: PathBuf,
    /// `<Scene>_trans.txt`, reference trajectory frame to scan frame.
    pub transform: PathBuf,
    /// `<Scene>_mapping_reference.txt`, if there.
    pub mapping: Option<PathBuf>,
}

impl TntFolder {
    /// Finds the scene's files in `folder`. The name is the folder's unless given; what is missing
    /// is said at once.
    ///
    /// # Errors
    /// Names the files that are missing; where no name is given, a folder that is not there or whose name is none or
    /// not in UTF-8.
    pub fn open(folder: &Path, name: Option<&str>) -> Result<Self> {
        let name = match name {
            Some(name) => name.to_owned(),
            None => name_of(folder)?,
        };
        let path = |suffix: &str| folder.join(format!("{name}{suffix}"));
        let missing: Vec<String> = SUFFIXES
            .iter()
            .filter(|suffix| !path(suffix).is_file())
            .map(|suffix| format!("{name}{suffix}"))
            .collect();
        if !missing.is_empty() {
            return Err(Error::layout(folder, said_missing(folder, &missing)));
        }
        let [truth, crop, trajectory, transform] = SUFFIXES.map(path);
        let mapping = Some(path("_mapping_reference.txt")).filter(|path| path.is_file());
        Ok(Self {
            truth,
            crop,
            trajectory,
            transform,
            mapping,
            name,
        })
    }

    /// Finds the one scene whose files are in `folder`: the one of the folder's name, else the only
    /// one; `None` where there is none or it is not clear which.
    pub fn find(folder: &Path) -> Option<Self> {
        Self::open(folder, None)
            .ok()
            .or_else(|| Self::open(folder, Some(&other_name(folder)?)).ok())
    }

    /// Reads the positions of the scan.
    ///
    /// # Errors
    /// As [`files::read_positions`].
    pub fn read_truth(&self) -> Result<Vec<DVec3>> {
        files::read_positions(&self.truth)
    }

    /// Reads the crop volume.
    ///
    /// # Errors
    /// As [`files::read_crop`].
    pub fn read_crop(&self) -> Result<CropVolume> {
        files::read_crop(&self.crop)
    }

    /// Reads the reference trajectory.
    ///
    /// # Errors
    /// As the function [`read_trajectory`].
    pub fn read_trajectory(&self) -> Result<Vec<LogPose>> {
        read_trajectory(&self.trajectory)
    }

    /// Reads the transform from the reference trajectory's frame to the scan's.
    ///
    /// # Errors
    /// As [`files::read_similarity`].
    pub fn read_transform(&self) -> Result<Similarity> {
        files::read_similarity(&self.transform)
    }

    /// Reads the mapping file, if there is one.
    ///
    /// # Errors
    /// As [`files::read_text`] and [`log::read_mapping`].
    pub fn read_mapping(&self) -> Result<Option<Mapping>> {
        self.mapping
            .as_deref()
            .map(|path| files::read_text_with(path, log::read_mapping))
            .transpose()
    }
}

/// Reads any `.log`.
///
/// # Errors
/// As [`files::read_text`] and [`log::read`].
pub fn read_trajectory(path: &Path) -> Result<Vec<LogPose>> {
    files::read_text_with(path, log::read)
}

/// The file of images of the COLMAP model at `path`, which is a folder with a model as
/// [`super::cameras::read_scene`] finds it; `None` where there is no model.
pub fn model_images(path: &Path) -> Option<PathBuf> {
    let place = model::model_place(path)?;
    let ending = model::colmap_ending(&place)?;
    Some(place.join(format!("images.{ending}")))
}

/// Reads a COLMAP file of images as the `.log` of a scene with `count` images, whose names are
/// numbers: pose i is that of the image whose number is i + 1, or i where one is numbered 0. Images
/// that the model does not have are unregistered poses, as the toolbox's converter writes them.
///
/// # Errors
/// A file that cannot be read, an image whose name is no number, whose number is beyond `count` or another's too, or
/// whose pose is none.
pub fn read_model_trajectory(images: &Path, count: usize) -> Result<Vec<LogPose>> {
    let read = match images.extension().is_some_and(|ending| ending == "bin") {
        true => files::read_with(images, colmap::read_images_binary)?,
        false => files::read_text_with(images, colmap::read_images_text)?,
    };
    poses_by_number(&read, count).map_err(Error::in_file(images))
}

fn poses_by_number(images: &[ColmapImage], count: usize) -> Result<Vec<LogPose>, FormatError> {
    let number = |image: &ColmapImage| {
        number_of(&image.name).ok_or_else(|| {
            let problem = "expected images whose names are their numbers (000001.jpg), so that they \
                           can be told apart, found another name: convert the model to a .log";
            FormatError::new(format!("image {} ({})", image.id, image.name), problem)
        })
    };
    let numbers = images.iter().map(number).collect::<Result<Vec<_>, _>>()?;
    let first = u32::from(!numbers.contains(&0));
    let unregistered = |index: usize| LogPose {
        metadata: [index as i64, -1, 0],
        world_from_cam: DMat4::IDENTITY,
    };
    let mut poses: Vec<Option<LogPose>> = vec![None; count];
    for (image, number) in images.iter().zip(&numbers) {
        let at =
            |problem| FormatError::new(format!("image {} ({})", image.id, image.name), problem);
        let index = (number - first) as usize;
        let place = poses.get_mut(index).ok_or_else(|| {
            at(format!(
                "expected the number of one of the scene's {count} cameras, found {number}: is the model \
                 of other images, or of frames of the video?"
            ))
        })?;
        let pose = image.to_pose().map_err(|error| at(error.to_string()))?;
        let mut world_from_cam = DMat4::from_mat3(pose.rotation().transpose());
        world_from_cam.w_axis = pose.center_in_world().extend(1.0);
        let pose = LogPose {
            metadata: [index as i64, index as i64, 0],
            world_from_cam,
        };
        if place.replace(pose).is_some() {
            return Err(at(format!(
                "expected each number once, found {number} twice"
            )));
        }
    }
    let poses = poses.into_iter().enumerate();
    Ok(poses
        .map(|(index, pose)| pose.unwrap_or_else(|| unregistered(index)))
        .collect())
}

/// The folder's own name, also for `.` and `..`.
fn name_of(folder: &Path) -> Result<String> {
    let real = folder.canonicalize().map_err(Error::io(folder, "open"))?;
    let name = real.file_name().and_then(|name| name.to_str());
    name.map(str::to_owned).ok_or_else(|| {
        Error::layout(
            folder,
            "expected a folder whose name is text, found none: give the scene's name",
        )
    })
}

/// What is missing, and which other name would fit.
fn said_missing(folder: &Path, missing: &[String]) -> String {
    let mut said = format!(
        "expected the files of a Tanks and Temples scene, found no {}",
        missing.join(", no ")
    );
    if let Some(other) = other_name(folder) {
        said.push_str(&format!(
            ": the folder holds the files of `{other}`, give that as the scene's name"
        ));
    }
    said
}

/// The one name all four files of which are in the folder.
fn other_name(folder: &Path) -> Option<String> {
    let mut names: Vec<String> = std::fs::read_dir(folder)
        .ok()?
        .filter_map(|entry| {
            let name = entry.ok()?.file_name().into_string().ok()?;
            Some(name.strip_suffix("_trans.txt")?.to_owned())
        })
        .filter(|name| {
            SUFFIXES
                .iter()
                .all(|suffix| folder.join(format!("{name}{suffix}")).is_file())
        })
        .collect();
    let only = names.pop();
    only.filter(|_| names.is_empty())
}

/// τ of the seven training scenes in metres; `None` for other names.
pub fn known_tolerance(scene: &str) -> Option<f64> {
    let known = TOLERANCES
        .iter()
        .find(|(name, _)| name.eq_ignore_ascii_case(scene));
    known.map(|&(_, tolerance)| tolerance)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write;

    fn put(path: &Path, text: &str) {
        files::write_atomically(path, |out| out.write_all(text.as_bytes())).unwrap();
    }

    fn scene_in(folder: &Path, name: &str) {
        put(&folder.join(format!("{name}.ply")), "ply\n");
        put(&folder.join(format!("{name}.json")), "{}");
        put(
            &folder.join(format!("{name}_COLMAP_SfM.log")),
            "0 0 0\n1 0 0 5\n0 1 0 0\n0 0 1 0\n0 0 0 1\n",
        );
        put(
            &folder.join(format!("{name}_trans.txt")),
            "2 0 0 0\n0 2 0 0\n0 0 2 0\n0 0 0 1\n",
        );
    }

    #[test]
    fn the_folder_names_the_scene() {
        let root = tempfile::tempdir().unwrap();
        let folder = root.path().join("Barn");
        scene_in(&folder, "Barn");
        let tnt = TntFolder::open(&folder, None).unwrap();
        assert_eq!((tnt.name.as_str(), &tnt.mapping), ("Barn", &None));
        assert_eq!(
            tnt.read_trajectory().unwrap()[0].world_from_cam.w_axis.x,
            5.0
        );
        assert_eq!(tnt.read_transform().unwrap().scale(), 2.0);
        assert_eq!(tnt.read_mapping().unwrap(), None);
        put(&folder.join("Barn_mapping_reference.txt"), "1\n9\n0 9\n");
        let mapping = TntFolder::open(&folder, None)
            .unwrap()
            .read_mapping()
            .unwrap();
        assert_eq!(mapping.unwrap().frames, [(0, 9)]);
        let error = tnt.read_crop().unwrap_err().to_string();
        assert!(error.contains("Barn.json: line 1"), "{error}");
    }

    #[test]
    fn all_that_is_missing_is_said_at_once() {
        let root = tempfile::tempdir().unwrap();
        let folder = root.path().join("pair");
        scene_in(&folder, "church");
        let error = TntFolder::open(&folder, None).unwrap_err().to_string();
        assert!(
            error.contains("no pair.ply, no pair.json, no pair_COLMAP_SfM.log"),
            "{error}"
        );
        assert!(error.contains("holds the files of `church`"), "{error}");
        assert_eq!(
            TntFolder::open(&folder, Some("church")).unwrap().name,
            "church"
        );
        let error = TntFolder::open(&root.path().join("none"), None)
            .unwrap_err()
            .to_string();
        assert!(error.contains("none: cannot open"), "{error}");
    }

    #[test]
    fn the_seven_scenes_have_a_tolerance() {
        assert_eq!(known_tolerance("Ignatius"), Some(0.003));
        assert_eq!(known_tolerance("truck"), Some(0.005));
        assert_eq!(known_tolerance("Panther"), None);
    }
}
