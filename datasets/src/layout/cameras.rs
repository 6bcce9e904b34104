//! Cameras as people have them: recognised by what lies there, brought to one convention.

use super::files;
use super::model::{model_files, model_place, read_model, read_points, text_beside};
use super::mvsnet::{self, CamsOptions, PixelCentre};
use super::numbers::number_names;
use super::tnt;
use crate::error::{Error, FormatError, Result};
use crate::format::transforms::{self, Frame};
use crate::scene::{Camera, Pose, Scene, View};
use glam::{DMat3, DMat4, DVec2};
use std::path::{Path, PathBuf};

/// What the files may leave open.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct CamerasOptions {
    /// Where the files put the centre of the top-left pixel. COLMAP models define it, so that
    /// [`PixelCentre::Integer`] is refused for them.
    pub pixel_centre: PixelCentre,
    /// Image size (width, height) where the files have none.
    pub size: Option<(u32, u32)>,
    /// Focal lengths in pixels where the files have none.
    pub focal: Option<DVec2>,
    /// Principal point in pixels, in the files' convention, where they have none; without it the
    /// image's centre is taken.
    pub center: Option<DVec2>,
}

/// A kind of camera files.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CameraSource {
    /// A folder of `cam.txt`, as MVSNet and BlendedMVS have it.
    Cams,
    /// A COLMAP model, binary or text.
    Colmap,
    /// NeRF's or nerfstudio's `transforms.json`.
    Transforms,
    /// A Tanks and Temples `.log`.
    Log,
}

impl CameraSource {
    /// What people call it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Cams => "MVSNet cameras",
            Self::Colmap => "COLMAP model",
            Self::Transforms => "transforms.json",
            Self::Log => "camera trajectory",
        }
    }
}

/// Cameras, and how they were understood.
#[derive(Debug, Clone, PartialEq)]
pub struct ReadCameras {
    /// The cameras.
    pub scene: Scene,
    /// What was found.
    pub source: CameraSource,
    /// The folder or file in which it was found.
    pub path: PathBuf,
    /// Sentences for the user: what was left out or could be meant otherwise.
    pub notes: Vec<String>,
}

/// Reads the cameras at `path`: a folder with `*_cam.txt` (or with `cams/`), a folder with a COLMAP
/// model (or with `sparse/0`, `sparse` or `colmap`), a folder with `transforms.json`, any `.json` in
/// that format, or a `.log`. Where a folder has several, the first in this order is taken and a note
/// says so.
///
/// View ids of COLMAP models and `transforms.json` are the numbers that are the images' names
/// (`00000012.jpg`), else, where a name is no number of at most eight digits or two are the same number, places in name
/// order; those of a `.log` are the poses' places in it.
///
/// # Errors
/// Nothing at `path` or no cameras there, files that cannot be read or do not fit together, [`PixelCentre::Integer`]
/// for a COLMAP model, and an image size or focal length that neither the files nor the options have.
pub fn read_scene(path: &Path, options: &CamerasOptions) -> Result<ReadCameras> {
    read_with_points(path, options, Points::Needed)
}

/// As [`read_scene`], to look at: where the file of a COLMAP model's points cannot be read, a note says why,
/// and views have no depth ranges.
///
/// # Errors
/// As [`read_scene`], but for the file of a COLMAP model's points.
pub fn inspect_scene(path: &Path, options: &CamerasOptions) -> Result<ReadCameras> {
    read_with_points(path, options, Points::Optional)
}

/// Whether a COLMAP model's points that are there must be readable.
#[derive(Clone, Copy)]
enum Points {
    Needed,
    Optional,
}

fn read_with_points(path: &Path, options: &CamerasOptions, points: Points) -> Result<ReadCameras> {
    let mut found = candidates(path)?;
    if found.is_empty() {
        let problem = "expected cameras: files such as 00000012_cam.txt, a number before _cam.txt (here or in cams/), a COLMAP model \
             (cameras, images as .bin or .txt; here, in sparse/0, sparse or colmap), \
             transforms.json or a .log file, found none of them";
        return Err(Error::layout(path, problem));
    }
    let (source, path) = found.remove(0);
    let (scene, mut notes) = match source {
        CameraSource::Cams => read_cams(&path, options)?,
        CameraSource::Colmap => read_colmap(&path, options, points)?,
        CameraSource::Transforms => read_transforms(&path, options)?,
        CameraSource::Log => read_log(&path, options)?,
    };
    if source != CameraSource::Transforms {
        let has_size = source == CameraSource::Colmap;
        let has_lens = has_size || source == CameraSource::Cams;
        notes.extend(unused(source, [has_size, has_lens, has_lens], options));
    }
    for (other, place) in found {
        notes.push(format!(
            "took the {}, not the {} in {}",
            source.name(),
            other.name(),
            place.display()
        ));
    }
    Ok(ReadCameras {
        scene,
        source,
        path,
        notes,
    })
}

/// Says which options give what the files have themselves.
fn unused(
    source: CameraSource,
    [has_size, has_focal, has_center]: [bool; 3],
    options: &CamerasOptions,
) -> Option<String> {
    let given = [
        (has_size && options.size.is_some(), "image size"),
        (has_focal && options.focal.is_some(), "focal length"),
        (has_center && options.center.is_some(), "principal point"),
    ];
    let unused: Vec<&str> = given
        .iter()
        .filter(|(unused, _)| *unused)
        .map(|(_, what)| *what)
        .collect();
    (!unused.is_empty()).then(|| {
        format!(
            "the given {} counts for nothing: {source:?} files have their own",
            unused.join(" and ")
        )
    })
}

/// The kind of cameras that [`read_scene`] takes at `path`, and every file that it reads; `None`
/// where there are none.
///
/// # Errors
/// Nothing at `path`, a folder that cannot be listed, and two `*_cam.txt` of one view.
pub fn source_files(path: &Path) -> Result<Option<(CameraSource, Vec<PathBuf>)>> {
    let Some((source, path)) = candidates(path)?.into_iter().next() else {
        return Ok(None);
    };
    let files = match source {
        CameraSource::Cams => mvsnet::scene_files(&path)?,
        CameraSource::Colmap => model_files(&path).into(),
        CameraSource::Transforms | CameraSource::Log => vec![path],
    };
    let there = files.into_iter().filter(|path| path.is_file());
    Ok(Some((source, there.collect())))
}

/// Whether views of a `transforms.json` have no image size and no focal length, neither in pixels nor as an angle of
/// view: [`read_scene`] needs what is not there as an option. Of other cameras neither is said.
///
/// # Errors
/// As [`source_files`], and a `transforms.json` that cannot be read.
pub fn left_open(path: &Path) -> Result<LeftOpen> {
    match candidates(path)?.first() {
        Some((CameraSource::Transforms, path)) => {
            let (frames, _) = files::read_text_with(path, transforms::read)?;
            Ok(LeftOpen {
                size: frames.iter().any(|frame| frame.size.is_none()),
                focal: !frames.iter().all(has_focal),
            })
        }
        _ => Ok(LeftOpen::default()),
    }
}

/// What some frames of a `transforms.json` do not say.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct LeftOpen {
    /// The size of their images.
    pub size: bool,
    /// Focal lengths, neither in pixels nor as angles of view.
    pub focal: bool,
}

fn has_focal(frame: &Frame) -> bool {
    frame.focal.is_some() || frame.angles[0].is_some()
}

/// Everything at `path` that looks like cameras, in order of preference.
fn candidates(path: &Path) -> Result<Vec<(CameraSource, PathBuf)>> {
    if !path.exists() {
        return Err(Error::layout(
            path,
            "expected camera files, found nothing there",
        ));
    }
    if path.is_file() {
        let kind = match path.extension().and_then(|ending| ending.to_str()) {
            Some("json") => Some(CameraSource::Transforms),
            Some("log") => Some(CameraSource::Log),
            _ => None,
        };
        return Ok(kind
            .map(|kind| (kind, path.to_path_buf()))
            .into_iter()
            .collect());
    }
    let mut found = Vec::new();
    if mvsnet::has_cams(path)? {
        found.push((CameraSource::Cams, path.to_path_buf()));
    }
    if let Some(place) = model_place(path) {
        found.push((CameraSource::Colmap, place));
    }
    let transforms = path.join("transforms.json");
    if transforms.is_file() {
        found.push((CameraSource::Transforms, transforms));
    }
    Ok(found)
}

fn read_cams(folder: &Path, options: &CamerasOptions) -> Result<(Scene, Vec<String>)> {
    let options = CamsOptions {
        pixel_centre: options.pixel_centre,
        size: options.size,
    };
    mvsnet::read_cameras(folder, &options)
}

fn read_colmap(
    folder: &Path,
    options: &CamerasOptions,
    needed: Points,
) -> Result<(Scene, Vec<String>)> {
    let mut notes = text_beside(folder);
    let points = read_points(folder).or_else(|error| match needed {
        Points::Needed => Err(error),
        Points::Optional => {
            notes.push(format!("{error}: without it views have no depth ranges"));
            Ok(Vec::new())
        }
    });
    let model = read_model(folder, options, points?)?;
    let scene = Scene::new(model.views()?);
    let scene = scene.map_err(|error| Error::layout(&model.images_path, error.to_string()))?;
    Ok((scene, notes))
}

fn read_transforms(path: &Path, options: &CamerasOptions) -> Result<(Scene, Vec<String>)> {
    let (frames, mut notes) = files::read_text_with(path, transforms::read)?;
    let has_size = frames.iter().all(|frame| frame.size.is_some());
    let has_focal = frames.iter().all(has_focal);
    let has_center = frames.iter().all(|frame| frame.center.is_some());
    let own = [has_size, has_focal, has_center];
    notes.extend(unused(CameraSource::Transforms, own, options));
    let names: Vec<&str> = frames.iter().map(|frame| frame.file.as_str()).collect();
    let ids = number_names(&names);
    let views = frames
        .iter()
        .zip(ids)
        .map(|(frame, id)| {
            let place = format!("frame {}", frame.file);
            frame_view(frame, id, options).map_err(FormatError::at(place))
        })
        .collect::<Result<Vec<_>, _>>()
        .map_err(Error::in_file(path))?;
    let scene = Scene::new(views).map_err(|error| Error::layout(path, error.to_string()))?;
    Ok((scene, notes))
}

fn frame_view(frame: &Frame, id: u32, options: &CamerasOptions) -> Result<View> {
    let Some((width, height)) = frame.size.or(options.size) else {
        let problem =
            "expected w and h in the file, found none: give --camera-size, the images' size";
        return Err(Error::invalid("camera", problem));
    };
    let from_angle = |side: u32, angle: f64| 0.5 * f64::from(side) / libm::tan(0.5 * angle);
    let [angle_x, angle_y] = frame.angles;
    let from_angles = angle_x.map(|angle| {
        let fx = from_angle(width, angle);
        DVec2::new(fx, angle_y.map_or(fx, |angle| from_angle(height, angle)))
    });
    let focal = frame
        .focal
        .map(DVec2::from_array)
        .or(from_angles)
        .or(options.focal);
    let Some(focal) = focal else {
        let problem =
            "expected fl_x or camera_angle_x in the file, found none: give --focal, in pixels";
        return Err(Error::invalid("camera", problem));
    };
    let given = frame.center.map(DVec2::from_array).or(options.center);
    let camera = camera_of((width, height), focal, given, options.pixel_centre)?;
    let mut world_from_cam = frame.world_from_gl_cam;
    world_from_cam.y_axis = -world_from_cam.y_axis;
    world_from_cam.z_axis = -world_from_cam.z_axis;
    Ok(View {
        id,
        name: frame.file.trim_start_matches("./").to_owned(),
        camera: camera.with_distortion(frame.distortion)?,
        pose: inverted(world_from_cam)?,
        depth_range: None,
    })
}

/// A camera whose principal point, where `given`, is in the files' convention.
fn camera_of(
    (width, height): (u32, u32),
    focal: DVec2,
    given: Option<DVec2>,
    pixel_centre: PixelCentre,
) -> Result<Camera> {
    let middle = 0.5 * DVec2::new(f64::from(width), f64::from(height));
    let center = given.map_or(middle, |center| center + pixel_centre.offset());
    Camera::new(width, height, focal, center)
}

/// The pose whose inverse is `world_from_cam`.
fn inverted(world_from_cam: DMat4) -> Result<Pose> {
    Pose::from_matrix(world_from_cam)?; // says what is wrong in the file's own terms
    let rotation = DMat3::from_mat4(world_from_cam).inverse();
    Pose::new(rotation, -(rotation * world_from_cam.w_axis.truncate()))
}

fn read_log(path: &Path, options: &CamerasOptions) -> Result<(Scene, Vec<String>)> {
    let poses = tnt::read_trajectory(path)?;
    let (Some(size), Some(focal)) = (options.size, options.focal) else {
        let missing = match (options.size, options.focal) {
            (None, None) => "no --camera-size and no --focal: give both",
            (None, Some(_)) => "no --camera-size: give it",
            _ => "no --focal: give it",
        };
        let problem = format!(
            "expected an image size and focal lengths beside a .log, which has none, found {missing}"
        );
        return Err(Error::layout(path, problem));
    };
    let camera = camera_of(size, focal, options.center, options.pixel_centre)?;
    let mut views = Vec::new();
    let mut unregistered = 0;
    for (id, pose) in (0u32..).zip(&poses) {
        if pose.is_unregistered() {
            unregistered += 1;
            continue;
        }
        let place = format!("pose {id}");
        let pose = inverted(pose.world_from_cam)
            .map_err(FormatError::at(place))
            .map_err(Error::in_file(path))?;
        views.push(View {
            id,
            name: String::new(),
            camera,
            pose,
            depth_range: None,
        });
    }
    let mut notes = Vec::new();
    if unregistered > 0 {
        let all = poses.len();
        notes.push(format!(
            "left out {unregistered} of {all} poses, which are not registered"
        ));
    }
    Ok((Scene::new(views)?, notes))
}

#[cfg(test)]
mod tests;
