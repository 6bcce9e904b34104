//! Ways to misread a scene's numbers: each is a convention that some tool has.

use crate::error::Result;
use glam::{DMat3, DMat4, DVec2, DVec3};
use mvs_datasets::scene::{Camera, Pose, View};
use serde::{Deserialize, Serialize};

/// How cameras and depths are understood.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Reading {
    /// As the format says.
    AsIs,
    /// The intrinsics put the centre of the top-left pixel at (0, 0).
    IntegerCentre,
    /// The intrinsics were moved by half a pixel once too often.
    DoubleHalf,
    /// The principal points lie so many pixels too far to the right and below.
    MovedCentre(f64),
    /// The extrinsics are camera-to-world.
    CameraToWorld,
    /// World-to-camera with +Y up and +Z backward.
    OpenGl,
    /// Camera-to-world with +Y up and +Z backward.
    CameraToWorldOpenGl,
    /// The intrinsics are for an image of this scale.
    ScaledIntrinsics(f64),
    /// The depth is the distance from the camera's centre.
    RangeDepth,
}

impl Reading {
    /// All ways, the right one first.
    pub(super) fn all() -> Vec<Self> {
        let mut all = vec![
            Self::AsIs,
            Self::IntegerCentre,
            Self::DoubleHalf,
            Self::CameraToWorld,
            Self::OpenGl,
            Self::CameraToWorldOpenGl,
            Self::RangeDepth,
        ];
        all.extend(MOVES.map(Self::MovedCentre));
        all.extend(SCALES.map(Self::ScaledIntrinsics));
        all
    }

    /// A stable name.
    pub fn code(self) -> &'static str {
        match self {
            Self::AsIs => "as-is",
            Self::IntegerCentre | Self::DoubleHalf => "half-pixel",
            Self::MovedCentre(_) => "moved-principal-point",
            Self::CameraToWorld => "swapped-pose",
            Self::OpenGl => "opengl-axes",
            Self::CameraToWorldOpenGl => "swapped-opengl-pose",
            Self::ScaledIntrinsics(_) => "scaled-intrinsics",
            Self::RangeDepth => "range-depth",
        }
    }

    /// What to do when this reading fits better.
    pub(super) fn advice(self) -> String {
        match self {
            Self::AsIs => "nothing is wrong".to_owned(),
            Self::IntegerCentre => "the principal points are for pixel centres at whole numbers: \
                 add 0.5, or read with integer pixel centres"
                .to_owned(),
            Self::DoubleHalf => {
                "the principal points are half a pixel too large: subtract 0.5".to_owned()
            }
            Self::MovedCentre(by) => {
                let (too, mend) = if by > 0.0 {
                    ("large", "subtract")
                } else {
                    ("small", "add")
                };
                let by = by.abs();
                format!("the principal points are about {by} px too {too}: {mend} {by}")
            }
            Self::CameraToWorld => "the extrinsics are camera-to-world: invert them".to_owned(),
            Self::OpenGl => "the camera axes are +Y up, +Z backward: negate rows 2 and 3 of the \
                 extrinsics"
                .to_owned(),
            Self::CameraToWorldOpenGl => "the extrinsics are camera-to-world with +Y up, +Z \
                 backward: negate columns 2 and 3, then invert"
                .to_owned(),
            Self::ScaledIntrinsics(scale) => format!(
                "the intrinsics are for images {scale:.4} times as large: divide them by {scale:.4}"
            ),
            Self::RangeDepth => {
                "the depths are distances from the camera's centre: divide each by \
                 the length of its pixel's ray at z = 1"
                    .to_owned()
            }
        }
    }

    /// The view as this reading understands it.
    pub(super) fn view(self, view: &View) -> Result<View> {
        let camera = &view.camera;
        let moved = |offset: f64| {
            Camera::new(
                camera.width(),
                camera.height(),
                camera.focal(),
                camera.center() + offset,
            )
        };
        let scaled = |by: f64| {
            let (focal, center) = (camera.focal() / by, camera.center() / by);
            Camera::new(camera.width(), camera.height(), focal, center)
        };
        let camera = match self {
            Self::IntegerCentre => moved(0.5)?,
            Self::DoubleHalf => moved(-0.5)?,
            Self::MovedCentre(by) => moved(-by)?,
            Self::ScaledIntrinsics(scale) => scaled(scale)?,
            _ => *camera,
        };
        let flip = DMat4::from_scale(DVec3::new(1.0, -1.0, -1.0));
        let matrix = view.pose.matrix();
        let pose = match self {
            Self::CameraToWorld => rigid_inverse(&matrix)?,
            Self::OpenGl => Pose::from_matrix(flip * matrix)?,
            Self::CameraToWorldOpenGl => rigid_inverse(&(matrix * flip))?,
            _ => view.pose,
        };
        Ok(View {
            camera,
            pose,
            ..view.clone()
        })
    }

    /// The z-depth that `value` at `pixel` stands for.
    pub(super) fn depth(self, camera: &Camera, pixel: DVec2, value: f32) -> f64 {
        let value = f64::from(value);
        if self == Self::RangeDepth {
            value / camera.ray(pixel).length()
        } else {
            value
        }
    }
}

/// Pixels by which a crop that is counted wrongly, or once too often, moves principal points.
const MOVES: [f64; 4] = [-2.0, -1.0, 1.0, 2.0];
/// Scales between image sizes that are in use: high and low resolution, halves, quarters.
const SCALES: [f64; 8] = [0.25, 0.375, 0.5, 0.75, 4.0 / 3.0, 2.0, 8.0 / 3.0, 4.0];

/// The inverse of a rotation and translation.
fn rigid_inverse(matrix: &DMat4) -> Result<Pose> {
    let rotation = DMat3::from_mat4(*matrix).transpose();
    Ok(Pose::new(rotation, -(rotation * matrix.w_axis.truncate()))?)
}
