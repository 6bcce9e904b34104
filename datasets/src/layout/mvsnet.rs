//! MVSNet's folder of cameras: `00000000_cam.txt` … and `pair.txt`.

use super::files;
use crate::error::{Error, FormatError, Result};
use crate::format::cam::{self, CamFile};
use crate::format::pair::{self, PairEntry};
use crate::scene::{Camera, DepthRange, Pose, Scene, SourceScore, View};
use glam::{DMat3, DVec2};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Hypotheses that the interval of a written `cam.txt` counts, as in BlendedMVS.
const DEPTH_COUNT: u32 = 128;

/// Where a foreign file puts the centre of the top-left pixel.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum PixelCentre {
    /// At (0.5, 0.5), as this crate does.
    #[default]
    Half,
    /// At (0, 0).
    Integer,
}

impl PixelCentre {
    /// What to add to a principal point of the foreign file to get this crate's, in pixels.
    pub fn offset(self) -> DVec2 {
        match self {
            Self::Half => DVec2::ZERO,
            Self::Integer => DVec2::splat(0.5),
        }
    }
}

/// How to read a folder of cams.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct CamsOptions {
    /// The files' convention.
    pub pixel_centre: PixelCentre,
    /// The image size (width, height) the intrinsics are for. Without it twice the principal point,
    /// rounded, is taken: `cam.txt` has no size.
    pub size: Option<(u32, u32)>,
}

/// Reads every `<id>_cam.txt` in `folder` (or in `folder/cams`) and [`pairs_file`] where present.
///
/// View names stay empty. Views that `pair.txt` does not list have no source views.
///
/// # Errors
/// A folder that cannot be listed, has no cams or two of one view; a `cam.txt` that cannot be read or whose pose,
/// intrinsics or depth range are none; a `pair.txt` that cannot be read, names a view without a cam or one as its own
/// source.
pub fn read_scene(folder: &Path, options: &CamsOptions) -> Result<Scene> {
    let (scene, unfit) = read_with_pairs(folder, options)?;
    unfit.map_or(Ok(scene), Err)
}

/// As [`read_scene`], for whoever needs cameras above all: a `pair.txt` beside the folder of cams, which may be of
/// other views, is left out where it does not fit, and why is said.
pub(super) fn read_cameras(folder: &Path, options: &CamsOptions) -> Result<(Scene, Vec<String>)> {
    let (scene, unfit) = read_with_pairs(folder, options)?;
    let notes = unfit.map(|error| format!("{error}: no source views are read"));
    Ok((scene, notes.into_iter().collect()))
}

/// The views, with their sources unless a `pair.txt` that does not lie beside the cams says something else.
fn read_with_pairs(folder: &Path, options: &CamsOptions) -> Result<(Scene, Option<Error>)> {
    let (cams, paths) = find_cams(folder)?;
    let views = paths
        .iter()
        .map(|(&id, path)| read_view(path, id, options))
        .collect::<Result<Vec<_>>>()?;
    let scene = Scene::new(views)?;
    let Some(pairs) = pairs_beside(folder, &cams) else {
        return Ok((scene, None));
    };
    let entries = files::read_text_with(&pairs, pair::read);
    let paired = entries
        .and_then(|entries| with_pairs(scene.clone(), entries).map_err(Error::in_file(&pairs)));
    match paired {
        Ok(scene) => Ok((scene, None)),
        Err(error) if pairs.parent() != Some(cams.as_path()) => Ok((scene, Some(error))),
        Err(error) => Err(error),
    }
}

/// Whether `folder`, or its `cams/`, holds any `<id>_cam.txt`.
///
/// # Errors
/// A folder that cannot be listed, and two `*_cam.txt` of one view.
pub fn has_cams(folder: &Path) -> Result<bool> {
    Ok(first_cams(folder)?.is_some())
}

/// Every file that [`read_scene`] reads for `folder`.
pub(super) fn scene_files(folder: &Path) -> Result<Vec<PathBuf>> {
    let (cams, paths) = find_cams(folder)?;
    let pairs = pairs_beside(folder, &cams);
    Ok(paths.into_values().chain(pairs).collect())
}

/// The `pair.txt` that goes with the cams of `folder`, if there is one: beside the cams, else beside their folder
/// `cams/`, as in MVSNet's data sets.
///
/// # Errors
/// As [`has_cams`].
pub fn pairs_file(folder: &Path) -> Result<Option<PathBuf>> {
    let found = first_cams(folder)?;
    Ok(found.and_then(|(cams, _)| pairs_beside(folder, &cams)))
}

fn pairs_beside(given: &Path, cams: &Path) -> Option<PathBuf> {
    let above = above(cams);
    let folders = [Some(cams), Some(given), above.as_deref()]
        .into_iter()
        .flatten();
    let mut pairs = folders.map(|folder| folder.join("pair.txt"));
    pairs.find(|path| path.is_file())
}

/// The folder that a folder called `cams` lies in, also where that is given as `.`.
pub fn above(cams: &Path) -> Option<PathBuf> {
    files::above(cams, "cams")
}

/// The folder that holds cams, and its cams by view id.
fn find_cams(folder: &Path) -> Result<(PathBuf, BTreeMap<u32, PathBuf>)> {
    first_cams(folder)?.ok_or_else(|| {
        let problem = "expected camera files like 00000000_cam.txt here or in cams/, found none";
        Error::layout(folder, problem)
    })
}

/// `folder` or its `cams/`, whichever has cams first.
fn first_cams(folder: &Path) -> Result<Option<(PathBuf, BTreeMap<u32, PathBuf>)>> {
    for candidate in [folder.to_path_buf(), folder.join("cams")] {
        if candidate != folder && !candidate.is_dir() {
            continue;
        }
        let cams = list_cams(&candidate)?;
        if !cams.is_empty() {
            return Ok(Some((candidate, cams)));
        }
    }
    Ok(None)
}

fn list_cams(folder: &Path) -> Result<BTreeMap<u32, PathBuf>> {
    let list = || Error::io(folder, "list the folder");
    let mut cams = BTreeMap::new();
    for entry in std::fs::read_dir(folder).map_err(list())? {
        let path = entry.map_err(list())?.path();
        let Some(id) = path.file_name().and_then(|name| id_of(name.to_str()?)) else {
            continue;
        };
        if let Some(other) = cams.insert(id, path.clone()) {
            let problem = format!(
                "expected one camera file per view, found {} too",
                other.display()
            );
            return Err(Error::layout(path, problem));
        }
    }
    Ok(cams)
}

/// Whether a name is that of some view's depth map: eight digits or more and `.pfm`.
pub fn is_depth_name(name: &str) -> bool {
    let number = name.strip_suffix(".pfm").unwrap_or_default();
    number.len() >= 8 && number.bytes().all(|byte| byte.is_ascii_digit())
}

/// The view id in a name like `00000012_cam.txt`.
fn id_of(name: &str) -> Option<u32> {
    let digits = name.strip_suffix("_cam.txt")?;
    if !digits.bytes().all(|byte| byte.is_ascii_digit()) {
        return None;
    }
    digits.parse().ok()
}

fn read_view(path: &Path, id: u32, options: &CamsOptions) -> Result<View> {
    files::read_text_with(path, |text| view_of(&cam::read(text)?, id, options))
}

fn view_of(cam: &CamFile, id: u32, options: &CamsOptions) -> Result<View, FormatError> {
    let pose = Pose::from_matrix(cam.extrinsic).map_err(FormatError::at("extrinsic"))?;
    let camera = camera_of(&cam.intrinsic, options).map_err(FormatError::at("intrinsic"))?;
    let depth_range = match cam.depth_range() {
        // Foreign files have 0 (or less) where no depth is known: that is no range.
        Some((min, _)) if min <= 0.0 => None,
        Some((min, max)) => Some(DepthRange::new(min, max).map_err(FormatError::at("depth line"))?),
        None => None,
    };
    Ok(View {
        id,
        name: String::new(),
        camera,
        pose,
        depth_range,
    })
}

fn camera_of(intrinsic: &DMat3, options: &CamsOptions) -> Result<Camera> {
    let (skew, below) = (intrinsic.y_axis.x, intrinsic.x_axis.y);
    if skew != 0.0 || below != 0.0 {
        let problem =
            format!("expected no skew, found {skew} and {below} beside the focal lengths");
        return Err(Error::invalid("camera", problem));
    }
    let focal = DVec2::new(intrinsic.x_axis.x, intrinsic.y_axis.y);
    let center = intrinsic.z_axis.truncate() + options.pixel_centre.offset();
    let (width, height) = options.size.unwrap_or_else(|| {
        let size = (2.0 * center).round();
        (size.x as u32, size.y as u32) // saturates; Camera refuses 0
    });
    Camera::new(width, height, focal, center)
}

/// Gives the scene the source views of a `pair.txt`.
fn with_pairs(scene: Scene, entries: Vec<PairEntry>) -> Result<Scene, FormatError> {
    let mut sources: Vec<Vec<SourceScore>> = vec![Vec::new(); scene.views().len()];
    for entry in entries {
        let place = || format!("entry of view {}", entry.id);
        let index = existing(&scene, entry.id, place)?;
        for source in &entry.sources {
            existing(&scene, source.id, place)?;
        }
        sources[index] = entry.sources;
    }
    scene
        .with_sources(sources)
        .map_err(FormatError::at("source views"))
}

fn existing(scene: &Scene, id: u32, place: impl FnOnce() -> String) -> Result<usize, FormatError> {
    scene.index_of(id).ok_or_else(|| {
        let name = file_name(id, "_cam.txt");
        let problem =
            format!("expected only views that have a camera file, found {id}: {name} is missing");
        FormatError::new(place(), problem)
    })
}

/// Writes `view` as a `cam.txt` at `path`, in the given convention. The view needs a depth range.
///
/// # Errors
/// A view without one, and what [`files::write_atomically`] brings.
pub fn write_view(path: &Path, view: &View, pixel_centre: PixelCentre) -> Result<()> {
    let Some(range) = view.depth_range else {
        let problem = format!(
            "expected view {} to have a depth range, found none",
            view.id
        );
        return Err(Error::layout(path, problem));
    };
    let mut intrinsic = view.camera.intrinsics();
    intrinsic.z_axis -= pixel_centre.offset().extend(0.0);
    let interval = range.interval(DEPTH_COUNT);
    let cam = CamFile {
        extrinsic: view.pose.matrix(),
        intrinsic,
        tail: vec![range.min(), interval, f64::from(DEPTH_COUNT), range.max()],
    };
    files::write_atomically(path, |out| cam::write(out, &cam))
}

/// Writes the scene's source views as a `pair.txt` at `path`.
///
/// # Errors
/// As [`files::write_atomically`].
pub fn write_pairs(path: &Path, scene: &Scene) -> Result<()> {
    let entries: Vec<PairEntry> = scene
        .views()
        .iter()
        .enumerate()
        .map(|(index, view)| PairEntry {
            id: view.id,
            sources: scene.sources_of(index).to_vec(),
        })
        .collect();
    files::write_atomically(path, |out| pair::write(out, &entries))
}

/// A file's eight-digit name for view `id`, e.g. `00000012_cam.txt` for the suffix `_cam.txt`.
pub fn file_name(id: u32, suffix: &str) -> String {
    format!("{id:08}{suffix}")
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DQuat, DVec3};
    use std::io::Write;

    fn view(id: u32) -> View {
        let rotation = DMat3::from_quat(DQuat::from_rotation_y(0.1 * f64::from(id)));
        View {
            id,
            name: String::new(),
            camera: Camera::new(64, 48, DVec2::new(70.0, 71.0), DVec2::new(32.0, 24.0)).unwrap(),
            pose: Pose::new(rotation, DVec3::new(0.1, 1.0 / 3.0, f64::from(id))).unwrap(),
            depth_range: Some(DepthRange::new(0.7, 3.1).unwrap()),
        }
    }

    fn scene() -> Scene {
        let source = |id, score| SourceScore { id, score };
        let lists = vec![
            vec![source(7, 2.5), source(12, 1.0 / 3.0)],
            vec![source(0, 1.0)],
            Vec::new(),
        ];
        Scene::new(vec![view(12), view(0), view(7)])
            .unwrap()
            .with_sources(lists)
            .unwrap()
    }

    fn write_all(folder: &Path, pixel_centre: PixelCentre) {
        for view in scene().views() {
            write_view(
                &folder.join(file_name(view.id, "_cam.txt")),
                view,
                pixel_centre,
            )
            .unwrap();
        }
        write_pairs(&folder.join("pair.txt"), &scene()).unwrap();
    }

    fn replace(path: &Path, from: &str, to: &str) {
        let text = files::read_text(path).unwrap();
        assert!(text.contains(from), "{text}");
        files::write_atomically(path, |out| write!(out, "{}", text.replacen(from, to, 1))).unwrap();
    }

    #[test]
    fn a_scene_reads_back_from_either_folder() {
        let root = tempfile::tempdir().unwrap();
        write_all(&root.path().join("cams"), PixelCentre::Half);
        let options = CamsOptions::default();
        assert_eq!(read_scene(root.path(), &options).unwrap(), scene());
        assert_eq!(
            read_scene(&root.path().join("cams"), &options).unwrap(),
            scene()
        );
    }

    /// As in MVSNet's data sets of DTU.
    #[test]
    fn pairs_may_lie_beside_the_folder_of_cams() {
        let root = tempfile::tempdir().unwrap();
        let (cams, above) = (root.path().join("cams"), root.path().join("pair.txt"));
        write_all(&cams, PixelCentre::Half);
        std::fs::rename(cams.join("pair.txt"), &above).unwrap();
        let options = CamsOptions::default();
        for given in [root.path(), &cams, &root.path().join("cams/")] {
            assert_eq!(read_scene(given, &options).unwrap(), scene());
            assert_eq!(pairs_file(given).unwrap(), Some(above.clone()));
            assert!(scene_files(given).unwrap().contains(&above));
        }
        // Of other views, they are no obstacle for whoever needs cameras.
        let fitting = std::fs::read(&above).unwrap();
        files::write_atomically(&above, |out| write!(out, "1\n99\n0\n")).unwrap();
        let without = Scene::new(scene().views().to_vec()).unwrap();
        assert!(read_scene(root.path(), &options).is_err());
        let (cameras, notes) = read_cameras(root.path(), &options).unwrap();
        assert_eq!(cameras, without);
        assert!(notes[0].contains("pair.txt") && notes[0].ends_with("no source views are read"));
        files::write_atomically(&cams.join("pair.txt"), |out| write!(out, "1\n99\n0\n")).unwrap();
        assert!(
            read_cameras(root.path(), &options).is_err(),
            "beside the cams"
        );
        files::write_atomically(&above, |out| out.write_all(&fitting)).unwrap();
        // Those beside the cams win, and of another folder's nothing is known.
        files::write_atomically(&cams.join("pair.txt"), |out| writeln!(out, "0")).unwrap();
        assert_eq!(read_scene(root.path(), &options).unwrap(), without);
        std::fs::remove_file(cams.join("pair.txt")).unwrap();
        let other = root.path().join("other");
        std::fs::rename(&cams, &other).unwrap();
        assert_eq!(read_scene(&other, &options).unwrap(), without);
        assert_eq!(pairs_file(&other).unwrap(), None);
    }

    #[test]
    fn integer_centres_are_half_a_pixel_less_on_disk() {
        let root = tempfile::tempdir().unwrap();
        write_all(root.path(), PixelCentre::Integer);
        let text = files::read_text(&root.path().join("00000000_cam.txt")).unwrap();
        assert!(text.contains("\n70 0 31.5\n0 71 23.5\n0 0 1\n"), "{text}");
        let options = CamsOptions {
            pixel_centre: PixelCentre::Integer,
            size: None,
        };
        assert_eq!(read_scene(root.path(), &options).unwrap(), scene());
        let misread = read_scene(root.path(), &CamsOptions::default()).unwrap();
        assert_eq!(misread.views()[0].camera.center(), DVec2::new(31.5, 23.5));
    }

    #[test]
    fn a_given_size_wins_over_the_guess() {
        let root = tempfile::tempdir().unwrap();
        write_all(root.path(), PixelCentre::Half);
        let options = CamsOptions {
            size: Some((66, 47)),
            ..CamsOptions::default()
        };
        let camera = read_scene(root.path(), &options).unwrap().views()[0].camera;
        assert_eq!((camera.width(), camera.height()), (66, 47));
        assert_eq!(camera.center(), DVec2::new(32.0, 24.0));
    }

    #[test]
    fn a_depth_of_0_and_less_is_no_range() {
        for smallest in ["0 ", "-0.7 "] {
            let root = tempfile::tempdir().unwrap();
            write_all(root.path(), PixelCentre::Half);
            replace(&root.path().join("00000007_cam.txt"), "0.7 ", smallest);
            let scene = read_scene(root.path(), &CamsOptions::default()).unwrap();
            let with = |view: &View| (view.id, view.depth_range.is_some());
            let with: Vec<(u32, bool)> = scene.views().iter().map(with).collect();
            assert!(
                with.contains(&(7, false)) && with.iter().any(|view| view.1),
                "{with:?}"
            );
        }
    }

    #[test]
    fn broken_cams_are_said_with_file_and_place() {
        for (from, to, expected) in [
            (
                "70 0 32",
                "0 0 32",
                "00000007_cam.txt: intrinsic: camera: expected focal lengths",
            ),
            ("70 0 32", "70 1 32", "expected no skew, found 1"),
            (
                "70 0 32",
                "70 0 -32",
                "expected at least 1x1 pixels, found 0x48",
            ),
            (
                "70 0 32",
                "-70 0 -32",
                "expected focal lengths above 0 px, found -70",
            ),
            (
                "0 0 0 1",
                "0 0 0 2",
                "00000007_cam.txt: extrinsic: pose: expected a last row",
            ),
            (
                "extrinsic\n0",
                "extrinsic\n9",
                "extrinsic: pose: expected an orthonormal rotation",
            ),
            (
                "0.7 ",
                "900.7 ",
                "00000007_cam.txt: depth line: depth range: expected 0 < min",
            ),
            (
                "intrinsic",
                "intrinsics",
                "expected the word `intrinsic`, found `intrinsics`",
            ),
        ] {
            let root = tempfile::tempdir().unwrap();
            write_all(root.path(), PixelCentre::Half);
            replace(&root.path().join("00000007_cam.txt"), from, to);
            let error = read_scene(root.path(), &CamsOptions::default())
                .unwrap_err()
                .to_string();
            assert!(error.contains(expected), "{error}");
        }
    }

    #[test]
    fn pairs_with_views_that_are_not_there_are_refused() {
        for (from, to, expected) in [
            (
                "\n7\n",
                "\n8\n",
                "pair.txt: entry of view 8: expected only views",
            ),
            (
                "7 2.5",
                "9 2.5",
                "entry of view 0: expected only views that have a camera file, found 9: 00000009_cam.txt is missing",
            ),
            (
                "7 2.5",
                "0 2.5",
                "expected the sources of view 0 to be other views",
            ),
        ] {
            let root = tempfile::tempdir().unwrap();
            write_all(root.path(), PixelCentre::Half);
            replace(&root.path().join("pair.txt"), from, to);
            let error = read_scene(root.path(), &CamsOptions::default())
                .unwrap_err()
                .to_string();
            assert!(error.contains(expected), "{error}");
        }
    }

    #[test]
    fn folders_without_cams_say_what_was_looked_for() {
        let root = tempfile::tempdir().unwrap();
        let read = |path: &Path| {
            read_scene(path, &CamsOptions::default())
                .unwrap_err()
                .to_string()
        };
        assert!(read(root.path()).contains("00000000_cam.txt here or in cams/, found none"));
        assert!(read(&root.path().join("no")).contains("cannot list the folder"));
        files::write_atomically(&root.path().join("1_cam.txt"), |_| Ok(())).unwrap();
        files::write_atomically(&root.path().join("01_cam.txt"), |_| Ok(())).unwrap();
        assert!(read(root.path()).contains("expected one camera file per view"));
    }

    #[test]
    fn a_view_without_depth_range_is_not_written() {
        let root = tempfile::tempdir().unwrap();
        let path = root.path().join("00000003_cam.txt");
        let without = View {
            depth_range: None,
            ..view(3)
        };
        let error = write_view(&path, &without, PixelCentre::Half)
            .unwrap_err()
            .to_string();
        assert!(
            error.contains("expected view 3 to have a depth range"),
            "{error}"
        );
        assert!(!path.exists());
    }
}
