//! `transforms.json` of NeRF and nerfstudio: frames with camera-to-world matrices in OpenGL axes.

use crate::error::FormatError;
use crate::scene::Distortion;
use glam::DMat4;
use serde_json::Value;

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
/// with its own camera.
///
/// # Errors
/// Names the frame that lacks size, focal lengths or principal point, or whose lens the format has no words for:
/// thin-prism, field-of-view, and k4 to k6 that are not 0.
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

fn wire_of(frame: &Frame) -> Result<Value, String> {
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
    applied_transform: Option<Value>,
    applied_scale: Option<Value>,
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
    is_fisheye: Option<bool>,
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
    k5: Option<f64>,
    k6: Option<f64>,
    p1: Option<f64>,
    p2: Option<f64>,
    /// nerfstudio's k1, k2, k3, k4, p1 and p2.
    distortion_params: Option<Vec<f64>>,
    lens: Option<Value>,
    ftheta_p0: Option<Value>,
    latlong: Option<Value>,
    equirectangular: Option<Value>,
    is_latlong: Option<Value>,
}

impl WireCamera {
    /// The focal lengths; that along x may stand for both.
    fn focal(&self) -> Result<Option<[f64; 2]>, String> {
        match (self.fl_x, self.fl_y) {
            (None, Some(_)) => Err("expected fl_x beside fl_y, found fl_y alone".to_owned()),
            (x, y) => Ok(x.map(|x| [x, y.unwrap_or(x)])),
        }
    }

    /// This frame's own values, else those of the file. An angle of view of its own is as good as a focal
    /// length.
    fn or(self, shared: &Self) -> Self {
        let mut shared = shared.clone();
        if self.fl_x.is_none() && self.camera_angle_x.is_some() {
            (shared.fl_x, shared.fl_y, shared.camera_angle_y) = (None, None, None);
        }
        if self.camera_model.is_some() || self.is_fisheye.is_some() {
            (shared.camera_model, shared.is_fisheye) = (None, None);
        }
        if self.coefficients().iter().any(Option::is_some) {
            shared.distortion_params = None;
        }
        Self {
            camera_model: self.camera_model.or(shared.camera_model),
            is_fisheye: self.is_fisheye.or(shared.is_fisheye),
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
            k5: self.k5.or(shared.k5),
            k6: self.k6.or(shared.k6),
            p1: self.p1.or(shared.p1),
            p2: self.p2.or(shared.p2),
            distortion_params: self.distortion_params.or(shared.distortion_params),
            lens: self.lens.or(shared.lens),
            ftheta_p0: self.ftheta_p0.or(shared.ftheta_p0),
            latlong: self.latlong.or(shared.latlong),
            equirectangular: self.equirectangular.or(shared.equirectangular),
            is_latlong: self.is_latlong.or(shared.is_latlong),
        }
    }

    /// k1 to k6, p1 and p2 as single values.
    fn coefficients(&self) -> [Option<f64>; 8] {
        [
            self.k1, self.k2, self.k3, self.k4, self.k5, self.k6, self.p1, self.p2,
        ]
    }

    /// Refuses lenses that are said otherwise than by a camera model and coefficients.
    fn refuse_other_lenses(&self) -> Result<(), String> {
        let is_set = |value: &Value| !matches!(value, Value::Null | Value::Bool(false));
        let is_plain = |value: &Value| {
            let name = value.as_str().unwrap_or_default().to_ascii_lowercase();
            ["perspective", "pinhole", "opencv"].contains(&name.as_str())
        };
        let others = [
            ("lens", &self.lens),
            ("ftheta_p0", &self.ftheta_p0),
            ("latlong", &self.latlong),
            ("equirectangular", &self.equirectangular),
            ("is_latlong", &self.is_latlong),
        ];
        for (name, value) in others {
            let value = value.as_ref().filter(|value| is_set(value));
            if let Some(value) = value.filter(|value| name != "lens" || !is_plain(value)) {
                let value: String = value.to_string().chars().take(40).collect();
                return Err(format!(
                    "expected the lens as a camera_model with k1 … p2, found {name} {value}, which is not read: \
                     take it out if it says nothing of the lens"
                ));
            }
        }
        Ok(())
    }

    /// k1 to k6, and p1 and p2: of the list, if there is one, as nerfstudio reads it.
    fn radial_tangential(&self) -> Result<([f64; 6], [f64; 2]), String> {
        match self
            .distortion_params
            .as_deref()
            .filter(|list| !list.is_empty())
        {
            Some(&[k1, k2, k3, k4, p1, p2]) => Ok(([k1, k2, k3, k4, 0.0, 0.0], [p1, p2])),
            Some(others) => Err(format!(
                "expected distortion_params as k1 k2 k3 k4 p1 p2, found {} numbers",
                others.len()
            )),
            None => {
                let [radial @ .., p1, p2] = self.coefficients().map(Option::unwrap_or_default);
                Ok((radial, [p1, p2]))
            }
        }
    }

    /// The camera model's name: the one given, else what instant-ngp's `is_fisheye` says.
    fn model(&self) -> Result<&str, String> {
        match (self.camera_model.as_deref(), self.is_fisheye) {
            (Some(model), Some(true)) if !model.contains("FISHEYE") => Err(format!(
                "expected is_fisheye without a camera model that is no fisheye, found true and `{}`: \
                 take one of them out",
                super::text::shown(model)
            )),
            (Some(model), _) => Ok(model),
            (None, Some(true)) => Ok("OPENCV_FISHEYE"),
            (None, _) => Ok("OPENCV"),
        }
    }

    /// Two values that mean something together only.
    fn both<T>(names: [&str; 2], pair: [Option<T>; 2]) -> Result<Option<[T; 2]>, String> {
        match pair {
            [Some(first), Some(second)] => Ok(Some([first, second])),
            [None, None] => Ok(None),
            [first, _] => {
                let [one, other] = names;
                let found = if first.is_some() { one } else { other };
                Err(format!(
                    "expected {one} and {other}, or neither, found only {found}"
                ))
            }
        }
    }

    fn distortion(&self) -> Result<Distortion, String> {
        self.refuse_other_lenses()?;
        let model = self.model()?;
        let (radial, tangential) = self.radial_tangential()?;
        let [k1, k2, k3, rational @ ..] = radial;
        let none_of =
            |names: &str, kind: &str, values: &[f64]| match values.iter().find(|v| **v != 0.0) {
                Some(found) => Err(format!(
                    "expected no {names} in a camera that is {kind}, found {found}"
                )),
                None => Ok(()),
            };
        match model {
            "OPENCV_FISHEYE" => {
                none_of("k5 and k6", "a fisheye", &rational[1..])?;
                let radial = [k1, k2, k3, rational[0]];
                Ok(Distortion::Fisheye { radial })
            }
            "OPENCV" | "PINHOLE" | "SIMPLE_PINHOLE" | "SIMPLE_RADIAL" | "RADIAL"
            | "perspective" | "FULL_OPENCV" => {
                if model != "FULL_OPENCV" {
                    none_of("k4, k5 and k6", "no fisheye and not FULL_OPENCV", &rational)?;
                }
                if radial == [0.0; 6] && tangential == [0.0; 2] {
                    return Ok(Distortion::None);
                }
                Ok(Distortion::RadialTangential { radial, tangential })
            }
            other => Err(format!(
                "expected the camera model OPENCV, FULL_OPENCV, OPENCV_FISHEYE or PINHOLE, found `{}`",
                super::text::shown(other)
            )),
        }
    }

    fn size(&self) -> Result<Option<(u32, u32)>, String> {
        let Some([w, h]) = Self::both(["w", "h"], [self.w, self.h])? else {
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

/// Frames, and what of the file was not followed, one sentence each.
pub type Read = (Vec<Frame>, Vec<String>);

/// Reads a `transforms.json`. Values of a frame win over those of the file. `applied_transform` and
/// `applied_scale` are not undone: poses stay in the frame in which the file gives them, and a sentence
/// says so.
///
/// # Errors
/// No JSON of this kind, no frames, and, naming the frame, a matrix of other than 3 or 4 rows, `w` or `h`, `cx` or
/// `cy` alone, `fl_y` without `fl_x`, sides that are not whole pixels, and lenses, models or coefficients that are
/// not read.
pub fn read(json: &str) -> Result<Read, FormatError> {
    let wire: WireFile = serde_json::from_str(json).map_err(|error| {
        let said = error.to_string();
        let problem = said.split(" at line ").next().unwrap_or_default();
        let found = match no_number(json, &error) {
            Some(name) => format!("{name}, which is no number in JSON: give finite ones"),
            None => format!("another text ({problem})"),
        };
        FormatError::new(
            format!("line {} column {}", error.line(), error.column()),
            format!("expected a transforms.json, found {found}"),
        )
    })?;
    if wire.frames.is_empty() {
        return Err(FormatError::new(
            "frames",
            "expected at least one frame, found none",
        ));
    }
    let notes = applied_notes(&wire);
    let frames = wire.frames.into_iter().enumerate();
    let frames = frames.map(|(index, frame)| {
        let place = format!("frame {index} ({})", super::text::shown(&frame.file_path));
        frame_of(frame, &wire.shared).map_err(|problem| FormatError::new(place, problem))
    });
    Ok((frames.collect::<Result<_, _>>()?, notes))
}

/// What Python writes for a number that is none, if that is what the error is about.
fn no_number(json: &str, error: &serde_json::Error) -> Option<&'static str> {
    let line = json.lines().nth(error.line().checked_sub(1)?)?;
    let mut starts = (1..=3)
        .rev()
        .filter_map(|back| line.get(error.column().checked_sub(back)?..));
    let name = |start: &str| {
        let mut names = ["NaN", "Infinity", "-Infinity"].into_iter();
        names.find(|name| start.starts_with(name))
    };
    starts.find_map(name)
}

/// What was done to the poses before they came into the file.
fn applied_notes(wire: &WireFile) -> Vec<String> {
    let given = [
        ("applied_transform", &wire.applied_transform),
        ("applied_scale", &wire.applied_scale),
    ];
    let given = given.into_iter().filter(|(_, value)| value.is_some());
    let names: Vec<&str> = given.map(|(name, _)| name).collect();
    let note = format!(
        "the file's {} is left in place: a mesh must be in the frame of the poses as the file has them",
        names.join(" and ")
    );
    (!names.is_empty()).then_some(note).into_iter().collect()
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
        focal: camera.focal()?,
        angles: [camera.camera_angle_x, camera.camera_angle_y],
        center: WireCamera::both(["cx", "cy"], [camera.cx, camera.cy])?,
        distortion: camera.distortion()?,
    })
}

#[cfg(test)]
mod tests;
