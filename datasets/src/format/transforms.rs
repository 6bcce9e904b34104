//! `transforms.json` of NeRF and nerfstudio: frames with camera-to-world matrices in OpenGL axes.

use crate::error::FormatError;
use crate::scene::Distortion;
use glam::DMat4;

/// One frame, with what the file says for all frames filled in.
#[derive(Debug, Clone, PartialEq)]
pub struct Frame {
    /// The image's path as in the file; original NeRF files leave the ending out.
    pub file: String,
    /// Camera-to-world, camera axes as in OpenGL: +X right, +Y up, +Z backward.
    pub world_from_gl_cam: DMat4,
    /// Width and height in pixels.
    pub size: Option<(u32, u32)>,
    /// Focal lengths in pixels.
    pub focal: Option<[f64; 2]>,
    /// Horizontal and vertical angle of view in radians.
    pub angles: [Option<f64>; 2],
    /// Principal point in pixels.
    pub center: Option<[f64; 2]>,
    /// The lens.
    pub distortion: Distortion,
}

/// Writes a `transforms.json` of frames with size, focal lengths and principal point, every frame
/// with its own camera. An error says which lens the format has no words for.
pub fn write(frames: &[Frame]) -> Result<String, String> {
    let fisheye = |frame: &Frame| matches!(frame.distortion, Distortion::Fisheye { .. });
    let written = frames.iter().map(wire_of).collect::<Result<Vec<_>, _>>()?;
    let model = |fish: bool| if fish { "OPENCV_FISHEYE" } else { "OPENCV" };
    let all = serde_json::json!({
        "camera_model": model(!frames.is_empty() && frames.iter().all(fisheye)),
        "frames": written,
    });
    let text = serde_json::to_string_pretty(&all).map_err(|error| error.to_string())?;
    Ok(text + "\n")
}

fn wire_of(frame: &Frame) -> Result<serde_json::Value, String> {
    let missing = || format!("expected size, focal lengths and center in {}", frame.file);
    let (w, h) = frame.size.ok_or_else(missing)?;
    let [fl_x, fl_y] = frame.focal.ok_or_else(missing)?;
    let [cx, cy] = frame.center.ok_or_else(missing)?;
    let rows = frame.world_from_gl_cam.transpose().to_cols_array_2d();
    let mut value = serde_json::json!({
        "file_path": frame.file,
        "camera_model": "OPENCV",
        "w": w, "h": h, "fl_x": fl_x, "fl_y": fl_y, "cx": cx, "cy": cy,
        "transform_matrix": rows,
    });
    let lens: Vec<(&str, f64)> = match frame.distortion {
        Distortion::None => Vec::new(),
        Distortion::Fisheye { radial } => {
            value["camera_model"] = "OPENCV_FISHEYE".into();
            ["k1", "k2", "k3", "k4"].into_iter().zip(radial).collect()
        }
        Distortion::RadialTangential { radial, tangential } => {
            if radial[3..] != [0.0; 3] {
                return Err(format!(
                    "expected a lens without the rational model's denominator (k4 to k6), which \
                     transforms.json cannot say, found one in {}",
                    frame.file
                ));
            }
            let names = ["k1", "k2", "k3", "p1", "p2"];
            let values = [
                radial[0],
                radial[1],
                radial[2],
                tangential[0],
                tangential[1],
            ];
            names.into_iter().zip(values).collect()
        }
        Distortion::ThinPrismFisheye { .. } | Distortion::FieldOfView { .. } => {
            return Err(format!(
                "expected a radial, tangential or fisheye lens, found a thin-prism or field-of-view \
                 one, which transforms.json cannot say, in {}",
                frame.file
            ));
        }
    };
    for (name, coefficient) in lens {
        value[name] = coefficient.into();
    }
    Ok(value)
}

#[derive(serde::Deserialize)]
struct WireFile {
    #[serde(flatten)]
    shared: WireCamera,
    frames: Vec<WireFrame>,
}

#[derive(serde::Deserialize)]
struct WireFrame {
    file_path: String,
    transform_matrix: Vec<[f64; 4]>,
    #[serde(flatten)]
    own: WireCamera,
}

#[derive(Default, Clone, serde::Deserialize)]
struct WireCamera {
    camera_model: Option<String>,
    camera_angle_x: Option<f64>,
    camera_angle_y: Option<f64>,
    fl_x: Option<f64>,
    fl_y: Option<f64>,
    cx: Option<f64>,
    cy: Option<f64>,
    w: Option<f64>,
    h: Option<f64>,
    k1: Option<f64>,
    k2: Option<f64>,
    k3: Option<f64>,
    k4: Option<f64>,
    p1: Option<f64>,
    p2: Option<f64>,
}

impl WireCamera {
    /// This frame's own values, else those of the file.
    fn or(self, shared: &Self) -> Self {
        let shared = shared.clone();
        Self {
            camera_model: self.camera_model.or(shared.camera_model),
            camera_angle_x: self.camera_angle_x.or(shared.camera_angle_x),
            camera_angle_y: self.camera_angle_y.or(shared.camera_angle_y),
            fl_x: self.fl_x.or(shared.fl_x),
            fl_y: self.fl_y.or(shared.fl_y),
            cx: self.cx.or(shared.cx),
            cy: self.cy.or(shared.cy),
            w: self.w.or(shared.w),
            h: self.h.or(shared.h),
            k1: self.k1.or(shared.k1),
            k2: self.k2.or(shared.k2),
            k3: self.k3.or(shared.k3),
            k4: self.k4.or(shared.k4),
            p1: self.p1.or(shared.p1),
            p2: self.p2.or(shared.p2),
        }
    }

    fn distortion(&self) -> Result<Distortion, String> {
        let model = self.camera_model.as_deref().unwrap_or("OPENCV");
        let radial = [self.k1, self.k2, self.k3, self.k4].map(Option::unwrap_or_default);
        let tangential = [self.p1, self.p2].map(Option::unwrap_or_default);
        let [k1, k2, k3, k4] = radial;
        match model {
            "OPENCV_FISHEYE" => Ok(Distortion::Fisheye { radial }),
            "OPENCV" | "PINHOLE" | "SIMPLE_PINHOLE" | "SIMPLE_RADIAL" | "RADIAL"
            | "perspective" => {
                if k4 != 0.0 {
                    return Err(format!(
                        "expected no k4 in a camera that is no fisheye, found {k4}"
                    ));
                }
                if radial == [0.0; 4] && tangential == [0.0; 2] {
                    return Ok(Distortion::None);
                }
                Ok(Distortion::RadialTangential {
                    radial: [k1, k2, k3, 0.0, 0.0, 0.0],
                    tangential,
                })
            }
            other => Err(format!(
                "expected the camera model OPENCV, OPENCV_FISHEYE or PINHOLE, found `{}`",
                super::text::shown(other)
            )),
        }
    }

    fn size(&self) -> Result<Option<(u32, u32)>, String> {
        let (Some(w), Some(h)) = (self.w, self.h) else {
            return Ok(None);
        };
        let whole = |side: f64| side.fract() == 0.0 && (1.0..=f64::from(u32::MAX)).contains(&side);
        if whole(w) && whole(h) {
            return Ok(Some((w as u32, h as u32)));
        }
        Err(format!(
            "expected w and h in whole pixels, found {w} and {h}"
        ))
    }
}

/// Reads a `transforms.json`. Values of a frame win over those of the file. `applied_transform` is
/// not undone: poses stay in the frame in which the file gives them.
pub fn read(json: &str) -> Result<Vec<Frame>, FormatError> {
    let wire: WireFile = serde_json::from_str(json).map_err(|error| {
        let said = error.to_string();
        let problem = said.split(" at line ").next().unwrap_or_default();
        FormatError::new(
            format!("line {} column {}", error.line(), error.column()),
            format!("expected a transforms.json, found another text ({problem})"),
        )
    })?;
    if wire.frames.is_empty() {
        return Err(FormatError::new(
            "frames",
            "expected at least one frame, found none",
        ));
    }
    let frames = wire.frames.into_iter().enumerate();
    frames
        .map(|(index, frame)| {
            let place = format!("frame {index} ({})", super::text::shown(&frame.file_path));
            frame_of(frame, &wire.shared).map_err(|problem| FormatError::new(place, problem))
        })
        .collect()
}

fn frame_of(frame: WireFrame, shared: &WireCamera) -> Result<Frame, String> {
    let rows = &frame.transform_matrix;
    let matrix = match rows[..] {
        [a, b, c] => [a, b, c, [0.0, 0.0, 0.0, 1.0]],
        [a, b, c, d] => [a, b, c, d],
        _ => {
            return Err(format!(
                "expected 3 or 4 rows in transform_matrix, found {}",
                rows.len()
            ));
        }
    };
    let camera = frame.own.or(shared);
    Ok(Frame {
        file: frame.file_path,
        world_from_gl_cam: DMat4::from_cols_array_2d(&matrix).transpose(),
        size: camera.size()?,
        focal: camera.fl_x.map(|fx| [fx, camera.fl_y.unwrap_or(fx)]),
        angles: [camera.camera_angle_x, camera.camera_angle_y],
        center: camera.cx.zip(camera.cy).map(|(cx, cy)| [cx, cy]),
        distortion: camera.distortion()?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const REAL: &str = r#"{"camera_model": "OPENCV", "fl_x": 500.0, "fl_y": 510, "cx": 321.5,
        "cy": 239.5, "w": 640, "h": 480.0, "k1": -0.1, "p2": 0.001, "aabb_scale": 16,
        "frames": [
        {"file_path": "./images/a.jpg", "transform_matrix": [[1, 0, 0, 5], [0, 1, 0, 6], [0, 0, 1, 7], [0, 0, 0, 1]]},
        {"file_path": "images/b.jpg", "fl_x": 600.0, "w": 320, "h": 240, "transform_matrix": [[1, 0, 0, 5], [0, 1, 0, 6], [0, 0, 1, 7]]}]}"#;

    #[test]
    fn a_frame_s_own_values_win() {
        let frames = read(REAL).unwrap();
        assert_eq!(
            (frames[0].size, frames[0].focal),
            (Some((640, 480)), Some([500.0, 510.0]))
        );
        assert_eq!(
            (frames[1].size, frames[1].focal),
            (Some((320, 240)), Some([600.0, 510.0]))
        );
        assert_eq!(
            frames[0].world_from_gl_cam.w_axis.to_array(),
            [5.0, 6.0, 7.0, 1.0]
        );
        assert_eq!(frames[0].world_from_gl_cam, frames[1].world_from_gl_cam);
        let lens = Distortion::RadialTangential {
            radial: [-0.1, 0.0, 0.0, 0.0, 0.0, 0.0],
            tangential: [0.0, 0.001],
        };
        assert_eq!(
            (frames[0].distortion, frames[0].center),
            (lens, Some([321.5, 239.5]))
        );
        let fisheye = read(&REAL.replace("\"OPENCV\"", "\"OPENCV_FISHEYE\"")).unwrap();
        let radial = [-0.1, 0.0, 0.0, 0.0];
        assert_eq!(fisheye[0].distortion, Distortion::Fisheye { radial });
    }

    #[test]
    fn broken_files_get_one_sentence() {
        for (from, to, expected) in [
            ("\"frames\"", "\"views\"", "missing field `frames`"),
            (
                "\"OPENCV\"",
                "\"EQUIRECTANGULAR\"",
                "frame 0 (./images/a.jpg): expected the camera model OPENCV",
            ),
            ("\"p2\": 0.001", "\"k4\": 0.5", "expected no k4"),
            (
                "[[1, 0, 0, 5], [0, 1, 0, 6], [0, 0, 1, 7]]}",
                "[[1, 0, 0, 5]]}",
                "frame 1 (images/b.jpg): expected 3 or 4 rows in transform_matrix, found 1",
            ),
            (
                "\"w\": 640",
                "\"w\": -1",
                "expected w and h in whole pixels, found -1 and 480",
            ),
        ] {
            let error = read(&REAL.replacen(from, to, 1)).unwrap_err().to_string();
            assert!(error.contains(expected) && !error.contains('\n'), "{error}");
        }
        assert!(read("").is_err() && read(&REAL[..REAL.len() / 2]).is_err());
        let none = read(r#"{"frames": []}"#).unwrap_err().to_string();
        assert!(none.contains("expected at least one frame"), "{none}");
    }
}
