//! COLMAP models: cameras, images and points, as text or binary.
//!
//! Pixel centres are at (0.5, 0.5) and poses are `cam_from_world`, as in this crate.

mod binary;
pub mod dense;
mod text;
mod write;

pub use binary::{
    read_cameras as read_cameras_binary, read_frames as read_frames_binary,
    read_images as read_images_binary, read_points as read_points_binary,
};
pub use text::{
    read_cameras as read_cameras_text, read_frames as read_frames_text,
    read_images as read_images_text, read_points as read_points_text,
};

pub use write::{
    no_points as write_no_points_text, write_cameras as write_cameras_text,
    write_images as write_images_text,
};

use crate::error::{Error, Result};
use crate::scene::{Camera, Distortion, Pose};
use glam::{DMat3, DQuat, DVec2, DVec3};
use std::num::FpCategory;

/// The camera models with their number in binary files and how many parameters they have.
const MODELS: [(&str, i32, usize); 18] = [
    ("SIMPLE_PINHOLE", 0, 3),
    ("PINHOLE", 1, 4),
    ("SIMPLE_RADIAL", 2, 4),
    ("RADIAL", 3, 5),
    ("OPENCV", 4, 8),
    ("OPENCV_FISHEYE", 5, 8),
    ("FULL_OPENCV", 6, 12),
    ("FOV", 7, 5),
    ("SIMPLE_RADIAL_FISHEYE", 8, 4),
    ("RADIAL_FISHEYE", 9, 5),
    ("THIN_PRISM_FISHEYE", 10, 12),
    ("RAD_TAN_THIN_PRISM_FISHEYE", 11, 16),
    ("SIMPLE_DIVISION", 12, 4),
    ("DIVISION", 13, 5),
    ("SIMPLE_FISHEYE", 14, 3),
    ("FISHEYE", 15, 4),
    ("EUCM", 16, 6),
    ("EQUIRECTANGULAR", 17, 2),
];

/// The sensor that takes images, as text and as a number, among those that frames have data of.
const CAMERA: (&str, i32) = ("CAMERA", 0);

/// The images of frames, each with the id of its sensor: frame after frame as they are listed, within
/// one by sensor, as COLMAP holds them.
fn in_order(mut frames: Vec<Vec<(u32, u32)>>) -> Vec<u32> {
    frames.iter_mut().for_each(|images| images.sort_unstable());
    frames.into_iter().flatten().map(|(_, id)| id).collect()
}

/// A camera of a model, shared by any number of images.
#[derive(Debug, Clone, PartialEq)]
pub struct ColmapCamera {
    /// The camera's number in the model.
    pub id: u32,
    /// The name of the camera model, e.g. `OPENCV`.
    pub model: &'static str,
    /// Image width in pixels.
    pub width: u32,
    /// Image height in pixels.
    pub height: u32,
    /// The model's parameters, in COLMAP's order.
    pub params: Vec<f64>,
}

/// A registered image.
#[derive(Debug, Clone, PartialEq)]
pub struct ColmapImage {
    /// The image's number in the model; numbers may have gaps.
    pub id: u32,
    /// The rotation of `cam_from_world` as a quaternion w, x, y, z; not always of length 1.
    pub rotation: [f64; 4],
    /// The translation of `cam_from_world`, in world units.
    pub translation: DVec3,
    /// The number of its camera.
    pub camera: u32,
    /// Its file, relative to the folder of images.
    pub name: String,
    /// The numbers of the points that it sees.
    pub points: Vec<u64>,
}

/// A triangulated point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ColmapPoint {
    /// The point's number in the model.
    pub id: u64,
    /// Where it is, in world units.
    pub position: DVec3,
    /// 8-bit sRGB colour.
    pub color: [u8; 3],
}

impl ColmapCamera {
    /// The camera in this crate's terms. Division, EUCM, equirectangular and rad-tan-thin-prism
    /// models are refused.
    ///
    /// # Errors
    /// Those models, parameters that are not as many as the model has, and what [`Camera::new`] and
    /// [`Camera::with_distortion`] refuse.
    pub fn to_camera(&self) -> Result<Camera> {
        let p = &self.params[..];
        let radial = |k1, k2| lens([k1, k2, 0.0, 0.0, 0.0, 0.0], [0.0; 2]);
        let fisheye = |k1, k2, k3, k4| Distortion::Fisheye {
            radial: [k1, k2, k3, k4],
        };
        let (focal, center, distortion) = match (self.model, p) {
            ("SIMPLE_PINHOLE", &[f, cx, cy]) => ([f, f], [cx, cy], Distortion::None),
            ("PINHOLE", &[fx, fy, cx, cy]) => ([fx, fy], [cx, cy], Distortion::None),
            ("SIMPLE_RADIAL", &[f, cx, cy, k]) => ([f, f], [cx, cy], radial(k, 0.0)),
            ("RADIAL", &[f, cx, cy, k1, k2]) => ([f, f], [cx, cy], radial(k1, k2)),
            ("OPENCV", &[fx, fy, cx, cy, k1, k2, p1, p2]) => {
                let lens = lens([k1, k2, 0.0, 0.0, 0.0, 0.0], [p1, p2]);
                ([fx, fy], [cx, cy], lens)
            }
            ("FULL_OPENCV", &[fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, k5, k6]) => {
                let lens = lens([k1, k2, k3, k4, k5, k6], [p1, p2]);
                ([fx, fy], [cx, cy], lens)
            }
            ("OPENCV_FISHEYE", &[fx, fy, cx, cy, k1, k2, k3, k4]) => {
                ([fx, fy], [cx, cy], fisheye(k1, k2, k3, k4))
            }
            ("SIMPLE_FISHEYE", &[f, cx, cy]) => ([f, f], [cx, cy], fisheye(0.0, 0.0, 0.0, 0.0)),
            ("FISHEYE", &[fx, fy, cx, cy]) => ([fx, fy], [cx, cy], fisheye(0.0, 0.0, 0.0, 0.0)),
            ("SIMPLE_RADIAL_FISHEYE", &[f, cx, cy, k]) => {
                ([f, f], [cx, cy], fisheye(k, 0.0, 0.0, 0.0))
            }
            ("RADIAL_FISHEYE", &[f, cx, cy, k1, k2]) => {
                ([f, f], [cx, cy], fisheye(k1, k2, 0.0, 0.0))
            }
            ("THIN_PRISM_FISHEYE", &[fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, s1, s2]) => {
                let lens = Distortion::ThinPrismFisheye {
                    radial: [k1, k2, k3, k4],
                    tangential: [p1, p2],
                    prism: [s1, s2],
                };
                ([fx, fy], [cx, cy], lens)
            }
            ("FOV", &[fx, fy, cx, cy, omega]) => {
                let lens = match omega.classify() {
                    FpCategory::Zero => Distortion::None,
                    _ => Distortion::FieldOfView { omega },
                };
                ([fx, fy], [cx, cy], lens)
            }
            (model, params) => {
                let problem = format!(
                    "expected a pinhole, radial, OpenCV, FOV or fisheye model, found {model} with {} \
                     parameters: undistort the images first",
                    params.len()
                );
                return Err(Error::invalid("camera", problem));
            }
        };
        let (focal, center) = (DVec2::from_array(focal), DVec2::from_array(center));
        Camera::new(self.width, self.height, focal, center)?.with_distortion(distortion)
    }
}

fn lens(radial: [f64; 6], tangential: [f64; 2]) -> Distortion {
    if radial == [0.0; 6] && tangential == [0.0; 2] {
        return Distortion::None;
    }
    Distortion::RadialTangential { radial, tangential }
}

impl ColmapImage {
    /// The pose in this crate's terms; the quaternion is brought to length 1.
    ///
    /// # Errors
    /// A quaternion that is 0 or not finite, and a translation that is not finite.
    pub fn to_pose(&self) -> Result<Pose> {
        let [w, x, y, z] = self.rotation;
        let length = libm::hypot(libm::hypot(w, x), libm::hypot(y, z));
        if !(length.is_finite() && length > 0.0) {
            let problem = format!(
                "expected a rotation, found the quaternion {:?}",
                self.rotation
            );
            return Err(Error::invalid("pose", problem));
        }
        let unit = DQuat::from_xyzw(x / length, y / length, z / length, w / length);
        Pose::new(DMat3::from_quat(unit), self.translation)
    }
}

#[cfg(test)]
mod tests;
