//! `cameras.bin`, `images.bin`, `points3D.bin` and `frames.bin`: little-endian, packed.

use super::{CAMERA, ColmapCamera, ColmapImage, ColmapPoint, MODELS, in_order};
use crate::error::FormatError;
use crate::format::text::shown;
use glam::DVec3;

/// The bytes not read yet.
struct Bytes<'a> {
    all: &'a [u8],
    at: usize,
}

impl<'a> Bytes<'a> {
    fn new(all: &'a [u8]) -> Self {
        Self { all, at: 0 }
    }

    fn wrong(&self, problem: String) -> FormatError {
        FormatError::new(format!("byte {}", self.at), problem)
    }

    fn take(&mut self, count: usize, what: &str) -> Result<&'a [u8], FormatError> {
        let rest = &self.all[self.at..];
        let Some(taken) = rest.get(..count) else {
            let problem = format!(
                "expected {count} more bytes for {what}, found {}: the file is cut short",
                rest.len()
            );
            return Err(self.wrong(problem));
        };
        self.at += count;
        Ok(taken)
    }

    fn array<const N: usize>(&mut self, what: &str) -> Result<[u8; N], FormatError> {
        let mut array = [0; N];
        array.copy_from_slice(self.take(N, what)?);
        Ok(array)
    }

    fn u32(&mut self, what: &str) -> Result<u32, FormatError> {
        self.array(what).map(u32::from_le_bytes)
    }

    fn u64(&mut self, what: &str) -> Result<u64, FormatError> {
        self.array(what).map(u64::from_le_bytes)
    }

    fn number(&mut self, what: &str) -> Result<f64, FormatError> {
        let number = self.array(what).map(f64::from_le_bytes)?;
        if number.is_finite() {
            return Ok(number);
        }
        Err(self.wrong(format!("expected {what} as finite numbers, found {number}")))
    }

    fn numbers<const N: usize>(&mut self, what: &str) -> Result<[f64; N], FormatError> {
        let mut numbers = [0.0; N];
        for number in &mut numbers {
            *number = self.number(what)?;
        }
        Ok(numbers)
    }

    /// A count of things of at least `each` bytes, which the file must be able to hold.
    fn count(&mut self, each: usize, what: &str) -> Result<usize, FormatError> {
        let count = self.u64(&format!("the count of {what}"))?;
        let room = (self.all.len() - self.at) / each;
        if count <= room as u64 {
            return Ok(count as usize);
        }
        Err(self.wrong(format!(
            "expected {count} {what} as the count says, found bytes for at most {room}: \
             the file is cut short or of another kind"
        )))
    }

    /// Everything is read.
    fn end(&self) -> Result<(), FormatError> {
        match self.all.len() - self.at {
            0 => Ok(()),
            more => Err(self.wrong(format!(
                "expected the end of the file, found {more} more bytes"
            ))),
        }
    }

    /// A list of `what`, each of at least `each` bytes, that fills the file.
    fn list<T>(
        &mut self,
        each: usize,
        what: &str,
        read: impl Fn(&mut Self) -> Result<T, FormatError>,
    ) -> Result<Vec<T>, FormatError> {
        let count = self.count(each, what)?;
        let list = (0..count)
            .map(|_| read(self))
            .collect::<Result<Vec<_>, _>>()?;
        self.end()?;
        Ok(list)
    }
}

/// Reads `cameras.bin`.
///
/// # Errors
/// A file that is cut short or goes on after what it counts, a model of another number than 0 to 17, sides above
/// 2³² − 1 pixels, and parameters that are not finite.
pub fn read_cameras(bytes: &[u8]) -> Result<Vec<ColmapCamera>, FormatError> {
    Bytes::new(bytes).list(40, "cameras", read_camera)
}

fn read_camera(bytes: &mut Bytes<'_>) -> Result<ColmapCamera, FormatError> {
    let id = bytes.u32("a camera id")?;
    let number = i32::from_le_bytes(bytes.array("a camera model")?);
    let Some(&(model, _, count)) = MODELS.iter().find(|(_, known, _)| *known == number) else {
        return Err(bytes.wrong(format!(
            "expected a camera model from 0 to 17, found {number}"
        )));
    };
    let width = bytes.u64("an image width")?;
    let height = bytes.u64("an image height")?;
    let (Ok(width), Ok(height)) = (u32::try_from(width), u32::try_from(height)) else {
        return Err(bytes.wrong(format!("expected an image size, found {width} x {height}")));
    };
    let params = (0..count)
        .map(|_| bytes.number("camera parameters"))
        .collect::<Result<Vec<_>, _>>()?;
    Ok(ColmapCamera {
        id,
        model,
        width,
        height,
        params,
    })
}

/// Reads `images.bin`.
///
/// # Errors
/// A file that is cut short or goes on after what it counts, poses that are not finite, and names without an end or
/// not in UTF-8.
pub fn read_images(bytes: &[u8]) -> Result<Vec<ColmapImage>, FormatError> {
    Bytes::new(bytes).list(73, "images", read_image)
}

fn read_image(bytes: &mut Bytes<'_>) -> Result<ColmapImage, FormatError> {
    let id = bytes.u32("an image id")?;
    let rotation = bytes.numbers::<4>("a quaternion")?;
    let translation = bytes.numbers::<3>("a translation")?;
    let camera = bytes.u32("a camera id")?;
    let rest = &bytes.all[bytes.at..];
    let Some(length) = rest.iter().position(|&byte| byte == 0) else {
        return Err(bytes.wrong("expected an image name that ends with 0, found no 0".into()));
    };
    let name = bytes.take(length, "an image name")?;
    let Ok(name) = std::str::from_utf8(name) else {
        let found = shown(&String::from_utf8_lossy(name));
        return Err(bytes.wrong(format!("expected an image name in UTF-8, found `{found}`")));
    };
    bytes.take(1, "an image name's end")?;
    let features = bytes.count(24, "features")?;
    let mut points = Vec::new();
    for _ in 0..features {
        bytes.take(16, "a feature's place")?;
        let point = i64::from_le_bytes(bytes.array("a feature's point")?);
        points.extend(u64::try_from(point));
    }
    Ok(ColmapImage {
        id,
        rotation,
        translation: DVec3::from_array(translation),
        camera,
        name: name.to_owned(),
        points,
    })
}

/// Reads `points3D.bin`.
///
/// # Errors
/// A file that is cut short or goes on after what it counts, and positions that are not finite.
pub fn read_points(bytes: &[u8]) -> Result<Vec<ColmapPoint>, FormatError> {
    Bytes::new(bytes).list(51, "points", |bytes| {
        let id = bytes.u64("a point id")?;
        let position = bytes.numbers::<3>("a position")?;
        let color = bytes.array("a color")?;
        bytes.take(8, "a point's error")?;
        let track = bytes.count(8, "observations")?;
        bytes.take(8 * track, "a point's observations")?;
        Ok(ColmapPoint {
            id,
            position: DVec3::from_array(position),
            color,
        })
    })
}

/// Reads `frames.bin`: the ids of the images in the order in which COLMAP registers them.
///
/// # Errors
/// A file that is cut short or goes on after what it counts, and image ids above 2³² − 1.
pub fn read_frames(bytes: &[u8]) -> Result<Vec<u32>, FormatError> {
    let frames = Bytes::new(bytes).list(68, "frames", |bytes| {
        bytes.take(64, "a frame's id, rig and pose")?;
        let count = bytes.u32("the count of a frame's data")?;
        let mut images = Vec::new();
        for _ in 0..count {
            let kind = i32::from_le_bytes(bytes.array("a kind of sensor")?);
            let sensor = bytes.u32("a sensor's id")?;
            let id = bytes.u64("a datum's id")?;
            if kind == CAMERA.1 {
                let image = u32::try_from(id);
                let wrong = |_| bytes.wrong(format!("expected an image id, found {id}"));
                images.push((sensor, image.map_err(wrong)?));
            }
        }
        Ok(images)
    })?;
    Ok(in_order(frames))
}
