//! `mvs-eval augment`: training images, changed at random as the BlendedMVS training does.

use super::{Context, OutDir};
use crate::blend;
use crate::error::{Error, Result};
use crate::generate;
use crate::generate::augment::{self, Step};
use crate::generate::masked;
use crate::parallel;
use mvs_datasets::format::image::{self, JpegOptions};
use mvs_datasets::layout::{blended, files};
use mvs_datasets::scene::{ColorImage, Mask};
use serde::{Deserialize, Serialize};
use std::io::Write;
use std::path::{Path, PathBuf};

/// Options of `mvs-eval augment`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct AugmentJob {
    /// A folder of images, or a scene with `blended_images/`.
    pub images: PathBuf,
    /// The folder for the changed images, named as the given ones, and `augment.json`.
    pub out: PathBuf,
    /// What is drawn follows from this and the view alone.
    pub seed: u64,
}

/// What was drawn.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct AugmentOutcome {
    /// The seed.
    pub seed: u64,
    /// The images, by file name.
    pub images: Vec<AugmentedImage>,
}

/// One image.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct AugmentedImage {
    /// The file's name.
    pub file: String,
    /// The number that the draw is for: the one that the name is, without `_masked` (a masked image
    /// has its view's draw); where the name is no number below 2³², a hash of it.
    pub view: u32,
    /// What was done to it, in order.
    pub steps: [Step; 3],
}

/// Changes every image of the folder.
///
/// # Errors
/// No folder given, none with images in it, a name that is not UTF-8 or a link that leads nowhere, an output folder
/// as [`OutDir::create`] refuses it, whatever reading and writing brings, and interruption.
pub fn run(job: &AugmentJob, context: &Context<'_>) -> Result<AugmentOutcome> {
    super::require(
        "augment",
        &[
            ("--images", &[&job.images], "a folder of images"),
            ("--out", &[&job.out], "a folder to write"),
        ],
    )?;
    let folder = image_folder(&job.images);
    let (names, others): (Vec<String>, Vec<String>) = blended::names_in(&folder)?
        .into_iter()
        .partition(|name| blended::is_image(name));
    if names.is_empty() {
        let problem = "expected images (.jpg or .png) here or in blended_images/, found none";
        return Err(mvs_datasets::Error::layout(&job.images, problem).into());
    }
    if let Some(name) = names.iter().find(|name| !folder.join(name).exists()) {
        let problem = "expected a file name in UTF-8, which records can hold, found other bytes: rename the file";
        return Err(Error::invalid(
            folder.join(name).display().to_string(),
            problem,
        ));
    }
    context.warn_of_unfinished(&[&folder], &job.out);
    let depths = depth_folder(&folder);
    let inputs: Vec<&Path> = [Some(&folder), depths.as_ref()]
        .into_iter()
        .flatten()
        .map(PathBuf::as_path)
        .collect();
    let run = context.run("augment", job, &OutDir::inputs(&job.out, &inputs)?)?;
    let out = OutDir::create(&job.out, run, context.force)?;
    let given: Vec<PathBuf> = names.iter().map(|name| folder.join(name)).collect();
    let given: Vec<&Path> = given.iter().map(PathBuf::as_path).collect();
    if let Some(warning) = generate::turned_warning(&given) {
        context.warnings.add(&warning.code, warning.message);
    }
    warn_of_others(&others, context);
    warn_of_masked(&folder, &names, context);
    context.progress.begin("augmenting", names.len() as u64);
    let images = parallel::try_map(names.len(), |index| {
        context.progress.check()?;
        let done = augment_one((&folder, depths.as_deref()), &names[index], job.seed, &out)?;
        context.progress.advance(1);
        Ok(done)
    })?;
    let outcome = AugmentOutcome {
        seed: job.seed,
        images,
    };
    out.write_json("augment.json", &outcome)?;
    out.finish()?;
    Ok(outcome)
}

/// Endings of images that are not read.
const UNREAD: [&str; 8] = ["bmp", "gif", "heic", "ppm", "tga", "tif", "tiff", "webp"];

/// Names images of other formats, which are left out.
fn warn_of_others(names: &[String], context: &Context<'_>) {
    let ending = |name: &str| {
        Path::new(name)
            .extension()
            .map(|end| end.to_ascii_lowercase())
    };
    let is_unread =
        |name: &&String| ending(name).is_some_and(|end| UNREAD.iter().any(|unread| end == *unread));
    let mut unread = names.iter().filter(is_unread);
    if let Some(first) = unread.next() {
        let message = format!(
            "{} images are left out, the first is {first}: expected .jpg or .png",
            1 + unread.count()
        );
        context.warnings.add("image-left-out", message);
    }
}

/// The folder itself, or the scene's folder of images.
fn image_folder(path: &Path) -> PathBuf {
    let inside = path.join("blended_images");
    if inside.is_dir() {
        inside
    } else {
        path.to_path_buf()
    }
}

/// The depth maps of the scene whose images the folder holds, if they are there.
fn depth_folder(images: &Path) -> Option<PathBuf> {
    let scene = files::above(images, "blended_images")?;
    Some(scene.join("rendered_depth_maps")).filter(|depths| depths.is_dir())
}

/// Where a masked image shows surface: where there is depth, else where it is brighter than a background.
fn mask_of(depths: Option<&Path>, name: &str, image: &ColorImage) -> Result<Mask> {
    let stem = stem_of(name);
    let stem = stem.strip_suffix(MASKED).unwrap_or(stem);
    let path = depths.map(|folder| folder.join(format!("{stem}.pfm")));
    if let Some(path) = path.filter(|path| path.is_file()) {
        let mask = files::read_depth(&path)?.0.valid_mask();
        if mask.size() == image.size() {
            return Ok(mask);
        }
        let ((width, height), (columns, rows)) = (image.size(), mask.size());
        let problem = format!(
            "expected {width}x{height} pixels as {name} has, found {columns}x{rows}: put depth maps of these \
             images there, or none to take what is black in the images for no surface"
        );
        return Err(Error::invalid(path.display().to_string(), problem));
    }
    Ok(image.map(|pixel| pixel.iter().any(|&level| level > masked::BACKGROUND)))
}

fn augment_one(
    (folder, depths): (&Path, Option<&Path>),
    name: &str,
    seed: u64,
    out: &OutDir,
) -> Result<AugmentedImage> {
    let path = folder.join(name);
    let given = files::read_image(&path)?;
    let view = view_of(name);
    let steps = augment::draw(seed, view);
    let is_png = name.to_ascii_lowercase().ends_with(".png");
    let jpeg = JpegOptions::default();
    if is_masked(name) {
        let whole = unmasked(folder, name).map(|whole| files::read_image(&whole));
        let mask = mask_of(depths, name, &given)?;
        let changed = augment::apply(whole.transpose()?.as_ref().unwrap_or(&given), &steps)?;
        let cut = blend::masked(&changed, &mask)
            .map_err(|error| Error::invalid(path.display().to_string(), error.to_string()))?;
        if is_png {
            out.write(name, |file| image::write_png(file, &cut))?;
        } else {
            let pair = masked::encode(&changed, &mask, jpeg)?;
            let bytes = pair.masked.unwrap_or(pair.whole);
            out.write(name, |file| file.write_all(&bytes))?;
        }
    } else {
        let changed = augment::apply(&given, &steps)?;
        out.write(name, |file| match is_png {
            true => image::write_png(file, &changed),
            false => image::write_jpeg(file, &changed, jpeg),
        })?;
    }
    Ok(AugmentedImage {
        file: name.to_owned(),
        view,
        steps,
    })
}

fn stem_of(name: &str) -> &str {
    name.rsplit_once('.').map_or(name, |(stem, _)| stem)
}

fn is_masked(name: &str) -> bool {
    stem_of(name).ends_with(MASKED)
}

/// What the stem of a masked image's name ends in.
const MASKED: &str = "_masked";

/// The image that a masked one is cut from, where it lies beside it: of that, not of its background, the contrast
/// is, so that both agree where there is surface.
fn unmasked(folder: &Path, name: &str) -> Option<PathBuf> {
    let (_, end) = name.rsplit_once('.')?;
    let stem = stem_of(name).strip_suffix(MASKED)?;
    let mut whole = [end, "jpg", "png", "jpeg"]
        .map(|end| folder.join(format!("{stem}.{end}")))
        .into_iter();
    whole.find(|path| path.is_file())
}

/// Names masked images whose whole ones are not there.
fn warn_of_masked(folder: &Path, names: &[String], context: &Context<'_>) {
    let is_alone = |name: &&String| is_masked(name) && unmasked(folder, name).is_none();
    let mut alone = names.iter().filter(is_alone);
    if let Some(first) = alone.next() {
        let message = format!(
            "{} masked images have no whole image beside them, the first is {first}: their contrast is against a \
             mean that their background lowers",
            1 + alone.count()
        );
        context.warnings.add("masked-alone", message);
    }
}

fn view_of(name: &str) -> u32 {
    let stem = stem_of(name);
    let stem = stem.strip_suffix(MASKED).unwrap_or(stem);
    let is_number = stem.bytes().all(|byte| byte.is_ascii_digit());
    let number = is_number.then(|| stem.parse().ok()).flatten();
    number.unwrap_or_else(|| {
        let hash = blake3::hash(stem.as_bytes());
        let [a, b, c, d, ..] = *hash.as_bytes();
        u32::from_le_bytes([a, b, c, d])
    })
}

#[cfg(test)]
mod tests {
    use super::view_of;

    #[test]
    fn a_masked_image_has_its_view_s_draw_and_other_names_their_own() {
        assert_eq!(
            (view_of("00000012.jpg"), view_of("00000012_masked.jpg")),
            (12, 12)
        );
        let stamps = ["1305031102.175304.png", "1305031102.211214.png"].map(view_of);
        assert_ne!(stamps[0], stamps[1]);
        let days = ["20261126_a.jpg", "20261126_b.jpg"].map(view_of);
        assert_ne!(days[0], days[1]);
        assert_eq!(view_of("left.jpg"), view_of("left_masked.jpg"));
        assert_ne!(view_of("4294967296.jpg"), 0);
    }
}
