//! `cameras.txt`, `images.txt`, `points3D.txt` and `frames.txt`.

use super::{CAMERA, ColmapCamera, ColmapImage, ColmapPoint, MODELS, in_order};
use crate::error::FormatError;
use crate::format::text::shown;
use glam::DVec3;

/// The fields of one line, taken one after another.
struct Fields<'a> {
    rest: &'a str,
    line: usize,
}

impl<'a> Fields<'a> {
    fn new(index: usize, text: &'a str) -> Self {
        Self {
            rest: text,
            line: index + 1,
        }
    }

    fn wrong(&self, expected: &str, found: &str) -> FormatError {
        let problem = format!("expected {expected}, found {found}");
        FormatError::new(format!("line {}", self.line), problem)
    }

    fn next(&mut self) -> Option<&'a str> {
        let text = self.rest.trim_start();
        let end = text.find(char::is_whitespace).unwrap_or(text.len());
        let (word, rest) = text.split_at(end);
        self.rest = rest;
        (!word.is_empty()).then_some(word)
    }

    fn word(&mut self, expected: &str) -> Result<&'a str, FormatError> {
        self.next()
            .ok_or_else(|| self.wrong(expected, "the line's end"))
    }

    fn whole<T: std::str::FromStr>(&mut self, expected: &str) -> Result<T, FormatError> {
        let word = self.word(expected)?;
        word.parse()
            .map_err(|_| self.wrong(expected, &format!("`{}`", shown(word))))
    }

    fn number(&mut self, expected: &str) -> Result<f64, FormatError> {
        let word = self.word(expected)?;
        match word.parse::<f64>() {
            Ok(number) if number.is_finite() => Ok(number),
            _ => Err(self.wrong(expected, &format!("`{}`", shown(word)))),
        }
    }

    fn numbers<const N: usize>(&mut self, expected: &str) -> Result<[f64; N], FormatError> {
        let mut numbers = [0.0; N];
        for number in &mut numbers {
            *number = self.number(expected)?;
        }
        Ok(numbers)
    }
}

/// Whether a line holds data.
fn is_data(line: &str) -> bool {
    !line.trim().is_empty() && !line.trim_start().starts_with('#')
}

/// Reads `cameras.txt`.
///
/// # Errors
/// Names the line: a model that COLMAP does not have, a value that is missing, no number or not finite, and more
/// parameters than the model has.
pub fn read_cameras(text: &str) -> Result<Vec<ColmapCamera>, FormatError> {
    let lines = text.lines().enumerate().filter(|(_, line)| is_data(line));
    lines
        .map(|(index, line)| read_camera(Fields::new(index, line)))
        .collect()
}

fn read_camera(mut fields: Fields<'_>) -> Result<ColmapCamera, FormatError> {
    let id = fields.whole("a camera id")?;
    let name = fields.word("a camera model")?;
    let Some(&(model, _, count)) = MODELS.iter().find(|(model, ..)| *model == name) else {
        return Err(fields.wrong(
            "a camera model that COLMAP has",
            &format!("`{}`", shown(name)),
        ));
    };
    let width = fields.whole("an image width")?;
    let height = fields.whole("an image height")?;
    let expected = format!("{count} parameters of the model {model}");
    let params = (0..count)
        .map(|_| fields.number(&expected))
        .collect::<Result<Vec<_>, _>>()?;
    if let Some(word) = fields.next() {
        return Err(fields.wrong(
            &format!("only {expected}"),
            &format!("`{}` too", shown(word)),
        ));
    }
    Ok(ColmapCamera {
        id,
        model,
        width,
        height,
        params,
    })
}

/// Reads `images.txt`: two lines per image, the second of which may be empty but must be there.
///
/// # Errors
/// A value that is missing, no number or not finite, an image without a name or a second line, and another number of
/// images than the head says.
pub fn read_images(text: &str) -> Result<Vec<ColmapImage>, FormatError> {
    let mut images = Vec::new();
    let mut lines = text.lines().enumerate();
    while let Some((index, line)) = lines.next() {
        if !is_data(line) {
            continue;
        }
        let mut image = read_image(Fields::new(index, line))?;
        let Some((index, line)) = lines.next() else {
            let problem = format!(
                "expected a second line with what image {} ({}) saw, empty where it saw nothing, found \
                 the file's end: it was cut, or its last empty line was taken off",
                image.id,
                shown(&image.name)
            );
            return Err(FormatError::new(format!("line {}", index + 2), problem));
        };
        image.points = read_observations(Fields::new(index, line))?;
        images.push(image);
    }
    match stated(text, "images") {
        Some(stated) if stated != images.len() => {
            let found = images.len();
            let problem = format!(
                "expected {stated} images, as its head says, found {found}: it was cut, or edited \
                 without its head"
            );
            Err(FormatError::new("images", problem))
        }
        _ => Ok(images),
    }
}

/// What COLMAP writes in the head: `# Number of images: 32, mean observations per image: 410`.
fn stated(text: &str, what: &str) -> Option<usize> {
    let head = text.lines().take_while(|line| line.starts_with('#'));
    let start = format!("# Number of {what}:");
    let mut counts = head.filter_map(|line| line.strip_prefix(&start));
    counts.next()?.split(',').next()?.trim().parse().ok()
}

fn read_image(mut fields: Fields<'_>) -> Result<ColmapImage, FormatError> {
    let id = fields.whole("an image id")?;
    let rotation = fields.numbers::<4>("a quaternion QW QX QY QZ")?;
    let translation = fields.numbers::<3>("a translation TX TY TZ")?;
    let camera = fields.whole("a camera id")?;
    // It may hold blanks, of any kind and number.
    let name = fields.rest.trim();
    if name.is_empty() {
        return Err(fields.wrong("an image name", "the line's end"));
    }
    Ok(ColmapImage {
        id,
        rotation,
        translation: DVec3::from_array(translation),
        camera,
        name: name.to_owned(),
        points: Vec::new(),
    })
}

/// The points that an image sees; −1 marks a feature without one.
fn read_observations(mut fields: Fields<'_>) -> Result<Vec<u64>, FormatError> {
    let mut points = Vec::new();
    while let Some(_x) = fields.next() {
        fields.number("Y of a feature X Y POINT3D_ID")?;
        let id: i64 = fields.whole("POINT3D_ID of a feature X Y POINT3D_ID")?;
        points.extend(u64::try_from(id));
    }
    Ok(points)
}

/// Reads `points3D.txt`.
///
/// # Errors
/// A value that is missing, no number or not finite, colours that are not 0 to 255, and another number of points than
/// the head says.
pub fn read_points(text: &str) -> Result<Vec<ColmapPoint>, FormatError> {
    let lines = text.lines().enumerate().filter(|(_, line)| is_data(line));
    let points: Vec<ColmapPoint> = lines
        .map(|(index, line)| {
            let mut fields = Fields::new(index, line);
            let id = fields.whole("a point id")?;
            let position = fields.numbers::<3>("a position X Y Z")?;
            let mut color = [0; 3];
            for channel in &mut color {
                *channel = fields.whole("a color R G B")?;
            }
            Ok(ColmapPoint {
                id,
                position: DVec3::from_array(position),
                color,
            })
        })
        .collect::<Result<_, _>>()?;
    match stated(text, "points") {
        Some(stated) if stated != points.len() => {
            let problem = format!(
                "expected {stated} points, as its head says, found {}: it was cut, or edited without its head",
                points.len()
            );
            Err(FormatError::new("points", problem))
        }
        _ => Ok(points),
    }
}

/// Reads `frames.txt`: the ids of the images in the order in which COLMAP registers them.
///
/// # Errors
/// Names the line: a value that is missing, no number or not finite.
pub fn read_frames(text: &str) -> Result<Vec<u32>, FormatError> {
    let lines = text.lines().enumerate().filter(|(_, line)| is_data(line));
    let frames = lines.map(|(index, line)| {
        let mut fields = Fields::new(index, line);
        let _: u32 = fields.whole("a frame id")?;
        let _: u32 = fields.whole("a rig id")?;
        fields.numbers::<7>("a pose QW QX QY QZ TX TY TZ")?;
        let count: u32 = fields.whole("the count of a frame's data")?;
        let mut images = Vec::new();
        for _ in 0..count {
            let kind = fields.word("a kind of sensor")?;
            let sensor = fields.whole("a sensor's id")?;
            match kind == CAMERA.0 {
                true => images.push((sensor, fields.whole("an image id")?)),
                false => drop(fields.word("a datum's id")?),
            }
        }
        Ok(images)
    });
    Ok(in_order(frames.collect::<Result<_, _>>()?))
}
