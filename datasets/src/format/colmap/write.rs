//! The text model. Numbers are written such that they read back to the same bits.

use super::{ColmapCamera, ColmapImage};
use crate::scene::{Camera, Distortion, Pose};
use glam::{DMat3, DQuat};
use std::fmt::Write;

impl ColmapCamera {
    /// The camera in COLMAP's terms: PINHOLE, OPENCV, FULL_OPENCV, OPENCV_FISHEYE,
    /// THIN_PRISM_FISHEYE or FOV.
    pub fn new(id: u32, camera: &Camera) -> Self {
        let (focal, center) = (camera.focal(), camera.center());
        let mut params = vec![focal.x, focal.y, center.x, center.y];
        let model = match camera.distortion() {
            Distortion::None => "PINHOLE",
            Distortion::Fisheye { radial } => {
                params.extend(radial);
                "OPENCV_FISHEYE"
            }
            Distortion::RadialTangential { radial, tangential } => {
                params.extend([radial[0], radial[1], tangential[0], tangential[1]]);
                if radial[2..] == [0.0; 4] {
                    "OPENCV"
                } else {
                    params.extend(&radial[2..]);
                    "FULL_OPENCV"
                }
            }
            Distortion::ThinPrismFisheye {
                radial: [k1, k2, k3, k4],
                tangential: [p1, p2],
                prism: [s1, s2],
            } => {
                params.extend([k1, k2, p1, p2, k3, k4, s1, s2]);
                "THIN_PRISM_FISHEYE"
            }
            Distortion::FieldOfView { omega } => {
                params.push(omega);
                "FOV"
            }
        };
        Self {
            id,
            model,
            width: camera.width(),
            height: camera.height(),
            params,
        }
    }
}

impl ColmapImage {
    /// An image without features. The rotation is the nearest exact one to the pose's, which may be rounded,
    /// and the camera's centre stays where it is.
    pub fn new(id: u32, pose: &Pose, camera: u32, name: String) -> Self {
        let turn = DQuat::from_mat3(&nearest_rotation(pose.rotation())).normalize();
        Self {
            id,
            rotation: [turn.w, turn.x, turn.y, turn.z],
            translation: -(DMat3::from_quat(turn) * pose.center_in_world()),
            camera,
            name,
            points: Vec::new(),
        }
    }
}

/// The rotation at the least distance (of all entries squared) from a matrix that is nearly one: the factor of
/// its polar decomposition, by Newton's steps, each of which squares what is missing.
fn nearest_rotation(mut matrix: DMat3) -> DMat3 {
    for _ in 0..4 {
        matrix = 0.5 * (matrix + matrix.inverse().transpose());
    }
    matrix
}

/// `cameras.txt`.
pub fn write_cameras(cameras: &[ColmapCamera]) -> String {
    let mut text = String::from("# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n");
    for camera in cameras {
        let params: Vec<String> = camera.params.iter().map(f64::to_string).collect();
        let _ = writeln!(
            text,
            "{} {} {} {} {}",
            camera.id,
            camera.model,
            camera.width,
            camera.height,
            params.join(" ")
        );
    }
    text
}

/// `images.txt`, without features.
pub fn write_images(images: &[ColmapImage]) -> String {
    let mut text = String::from(
        "# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME\n\
         # POINTS2D[] as X, Y, POINT3D_ID: none\n",
    );
    for image in images {
        let [w, x, y, z] = image.rotation;
        let t = image.translation;
        let _ = writeln!(
            text,
            "{} {w} {x} {y} {z} {} {} {} {} {}\n",
            image.id, t.x, t.y, t.z, image.camera, image.name
        );
    }
    text
}

/// A `points3D.txt` without points.
pub fn no_points() -> String {
    "# POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as IMAGE_ID, POINT2D_IDX: none\n".to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DVec3, EulerRot};

    fn distance(a: DMat3, b: DMat3) -> f64 {
        (a - b)
            .to_cols_array()
            .map(|entry| entry * entry)
            .iter()
            .sum()
    }

    #[test]
    fn no_rotation_is_nearer_to_a_rounded_one() {
        for step in 0..20 {
            let t = f64::from(step);
            let exact = DMat3::from_euler(EulerRot::XYZ, 2.9 * t, 1.1 * t, -0.7 * t);
            let rounded = exact
                .to_cols_array()
                .map(|entry| (entry * 1e3).round() / 1e3);
            let rounded = DMat3::from_cols_array(&rounded);
            let nearest = nearest_rotation(rounded);
            let off = distance(nearest * nearest.transpose(), DMat3::IDENTITY);
            assert!(off < 1e-28, "{off}");
            for axis in [DVec3::X, DVec3::Y, DVec3::Z, DVec3::ONE.normalize()] {
                for angle in [-1e-3, -1e-6, 1e-6, 1e-3] {
                    let other = DMat3::from_axis_angle(axis, angle) * nearest;
                    assert!(distance(other, rounded) >= distance(nearest, rounded));
                }
            }
        }
    }
}
