//! `mvs-eval blend`: renderings + photographs → blended images.

use super::render::NAMES;
use super::{Context, OutDir};
use crate::blend::{BlendOptions, Blender};
use crate::error::{Error, Result};
use crate::generate::{self, covering, find_named, masked, same_shape};
use crate::parallel;
use mvs_datasets::format::image::JpegOptions;
use mvs_datasets::layout::blended::record::read_json;
use mvs_datasets::layout::{blended, files};
use mvs_datasets::scene::{ColorImage, Mask};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::io::Write;
use std::path::{Path, PathBuf};

/// Options of `mvs-eval blend`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct BlendJob {
    /// What `render` wrote (`color/` and `depth/`), or a folder of renderings on black.
    pub rendered: PathBuf,
    /// A folder of photographs with the names of the images that were rendered (`views.json` of `render`), else
    /// with the renderings'; resized to cover the renderings and cut to their centre.
    pub photos: PathBuf,
    /// The folder for `<name>.jpg` and `<name>_masked.jpg`.
    pub out: PathBuf,
    /// How to blend.
    pub blend: BlendOptions,
}

/// What was blended.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct BlendOutcome {
    /// The images, by name.
    pub images: Vec<BlendedImage>,
}

/// One blended image.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct BlendedImage {
    /// The file's name without ending.
    pub name: String,
    /// Width and height in pixels.
    pub size: (u32, u32),
    /// Pixels of the rendering that show a surface.
    pub surface: usize,
    /// Whether the photograph had another size and was resized.
    pub resized: bool,
    /// Whether it had another shape too and lost what lies beyond.
    pub cut: bool,
    /// How like the photograph is to the rendering, -1 to 1: the mean over tiles of the correlation of their
    /// brightness; none where the rendering shows too little texture.
    pub likeness: Option<f64>,
    /// Mean absolute difference of rendering and photograph on the surface, in grey levels.
    pub difference_before: f64,
    /// The same of blended image and photograph.
    pub difference_after: f64,
}

/// The files of one image.
struct Input {
    name: String,
    rendering: PathBuf,
    depth: Option<PathBuf>,
    photograph: PathBuf,
}

/// Blends every rendering with the photograph of its name.
///
/// # Errors
/// A folder not given, no renderings, two of one name or that become one file, a rendering without its photograph,
/// renderings that are all black, a depth map or options that do not go with them, an output folder as
/// [`OutDir::create`] refuses it, whatever reading and writing brings, and interruption.
pub fn run(job: &BlendJob, context: &Context<'_>) -> Result<BlendOutcome> {
    super::require(
        "blend",
        &[
            ("--rendered", &[&job.rendered], "a folder of renderings"),
            ("--photos", &[&job.photos], "a folder of photographs"),
            ("--out", &[&job.out], "a folder to write"),
        ],
    )?;
    context.warn_of_unfinished(&[&job.rendered, &job.photos], &job.out);
    let inputs = find_inputs(job)?;
    let run = context.run(
        "blend",
        job,
        &OutDir::inputs(&job.out, &[&job.rendered, &job.photos])?,
    )?;
    let out = OutDir::create(&job.out, run, context.force)?;
    let photographs: Vec<&Path> = inputs
        .iter()
        .map(|input| input.photograph.as_path())
        .collect();
    if let Some(warning) = generate::turned_warning(&photographs) {
        context.warnings.add(&warning.code, warning.message);
    }
    context.progress.begin("blending", inputs.len() as u64);
    let images = parallel::try_map_pieces(inputs.len(), |index| {
        context.progress.check()?;
        let image = blend_one(&inputs[index], job, &out)?;
        context.progress.advance(1);
        Ok(image)
    })?;
    let cut: Vec<&BlendedImage> = images.iter().filter(|image| image.cut).collect();
    if let Some(first) = cut.first() {
        let message = format!(
            "{} photographs have another shape than their renderings and are cut to the centre; the \
             first is {}",
            cut.len(),
            first.name
        );
        context.warnings.add("photograph-cut", message);
    }
    let likeness = images.iter().map(|image| (&image.name, image.likeness));
    if let Some(warning) = generate::warning_of_unlike(likeness) {
        context.warnings.add(&warning.code, warning.message);
    }
    warn_of_empty(&images, job, context)?;
    out.finish()?;
    Ok(BlendOutcome { images })
}

/// Says which renderings show nothing; an error if all do.
fn warn_of_empty(images: &[BlendedImage], job: &BlendJob, context: &Context<'_>) -> Result<()> {
    let empty: Vec<&BlendedImage> = images.iter().filter(|image| image.surface == 0).collect();
    let Some(first) = empty.first() else {
        return Ok(());
    };
    if empty.len() == images.len() {
        let problem = format!(
            "expected renderings of a surface on black, found {} that are black",
            images.len()
        );
        return Err(Error::invalid(job.rendered.display().to_string(), problem));
    }
    let message = format!(
        "{} of {} renderings are black, so that nothing is blended with their photographs; the first is {}",
        empty.len(),
        images.len(),
        first.name
    );
    context.warnings.add("nothing-rendered", message);
    Ok(())
}

/// Refuses renderings both of which would become one file.
fn check_names(renderings: &BTreeMap<String, PathBuf>) -> Result<()> {
    for (name, path) in renderings {
        if let Some(masked) = renderings.get(&format!("{name}_masked")) {
            let problem = format!(
                "expected renderings that become files of their own, found {} beside it: both become {name}_masked.jpg; \
                 rename or remove one",
                masked.display()
            );
            return Err(Error::invalid(path.display().to_string(), problem));
        }
    }
    Ok(())
}

/// Pairs renderings with photographs by the names that `render` says their images have, else by their own.
fn find_inputs(job: &BlendJob) -> Result<Vec<Input>> {
    let color = job.rendered.join("color");
    let from_render = color.is_dir();
    let renderings = images_in(if from_render { &color } else { &job.rendered })?;
    if renderings.is_empty() {
        let problem = "expected renderings (.png or .jpg) here or in color/, found none";
        return Err(mvs_datasets::Error::layout(&job.rendered, problem).into());
    }
    check_names(&renderings)?;
    let names: BTreeMap<String, String> = read_json(&job.rendered.join(NAMES))?.unwrap_or_default();
    let photographs = match renderings.keys().all(|name| names.contains_key(name)) {
        true => BTreeMap::new(),
        false => images_in(&job.photos)?,
    };
    // Where two folders have an image of one name, the folder is part of it.
    let files: BTreeSet<_> = names
        .values()
        .map(|name| Path::new(name).file_name())
        .collect();
    let nested = files.len() < names.len();
    let pair = |(name, rendering): (String, PathBuf)| {
        let image = names.get(&name);
        let found = match image {
            Some(image) => find_named(&job.photos, image, nested)?,
            None => photographs.get(&name).cloned(),
        };
        let photograph = found.ok_or_else(|| {
            let image = image.unwrap_or(&name);
            let problem = format!("expected a photograph of the name `{image}`, found none");
            mvs_datasets::Error::layout(&job.photos, problem)
        })?;
        let depth = job.rendered.join("depth").join(format!("{name}.pfm"));
        Ok(Input {
            name,
            rendering,
            depth: from_render.then_some(depth),
            photograph,
        })
    };
    renderings.into_iter().map(pair).collect()
}

/// The images of a folder by name without ending, but for hidden files.
fn images_in(folder: &Path) -> Result<BTreeMap<String, PathBuf>> {
    let io = |action| mvs_datasets::Error::io(folder, action);
    let mut images = BTreeMap::new();
    for entry in std::fs::read_dir(folder).map_err(io("read the folder"))? {
        let path = entry.map_err(io("read the folder"))?.path();
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        let is_image = blended::is_image(&name);
        if let (true, Some(stem)) = (is_image, path.file_stem()) {
            let stem = stem.to_string_lossy().into_owned();
            if let Some(other) = images.insert(stem.clone(), path.clone()) {
                let (first, second) = (other.clone().min(path.clone()), other.max(path));
                let problem = format!(
                    "expected one image of the name `{stem}`, found {} and {}: remove one",
                    first.display(),
                    second.display()
                );
                return Err(mvs_datasets::Error::layout(folder, problem).into());
            }
        }
    }
    Ok(images)
}

/// Where a rendering is not black. Beside a surface a JPEG's black is not quite; what readers of masked images take
/// for background is background here too.
fn surface_of(rendering: &ColorImage, path: &Path) -> Mask {
    let exact = path
        .extension()
        .is_some_and(|ending| ending.eq_ignore_ascii_case("png"));
    let black = if exact { 0 } else { masked::BACKGROUND };
    rendering.map(|pixel| pixel.iter().any(|&level| level > black))
}

fn blend_one(input: &Input, job: &BlendJob, out: &OutDir) -> Result<BlendedImage> {
    let rendering = files::read_image(&input.rendering)?;
    let mask = match &input.depth {
        Some(path) => files::read_depth(path)?.0.valid_mask(),
        None => surface_of(&rendering, &input.rendering),
    };
    let photograph = files::read_image(&input.photograph)?;
    let size = rendering.size();
    let named = |error: Error| Error::invalid(input.name.clone(), error.to_string());
    let taken = photograph.size();
    let fitted = covering(photograph, size)?;
    let blender = Blender::new(size, &job.blend)?;
    let blended = blender.blend(&rendering, &fitted, &mask).map_err(named)?;
    let write = |suffix: &str, bytes: &[u8]| {
        out.write(format!("{}{suffix}.jpg", input.name), |file| {
            file.write_all(bytes)
        })
    };
    let jpeg = JpegOptions::default();
    let pair = generate::masked::encode(&blended, &mask, jpeg)?;
    write("", &pair.whole)?;
    write("_masked", pair.masked.as_ref().unwrap_or(&pair.whole))?;
    Ok(BlendedImage {
        name: input.name.clone(),
        size,
        surface: mask.values().iter().filter(|&&inside| inside).count(),
        resized: taken != size,
        cut: !same_shape(taken, size),
        likeness: generate::likeness(&rendering, &fitted, &mask),
        difference_before: mean_difference(&rendering, &fitted, &mask),
        difference_after: mean_difference(&blended, &fitted, &mask),
    })
}

/// Mean absolute difference over channels and the mask's pixels; 0 where the mask is empty.
fn mean_difference(first: &ColorImage, second: &ColorImage, mask: &Mask) -> f64 {
    let pairs = first
        .values()
        .iter()
        .zip(second.values())
        .zip(mask.values());
    let inside = pairs.filter(|(_, inside)| **inside);
    let (mut sum, mut count) = (0u64, 0u64);
    for ((a, b), _) in inside {
        sum += (0..3).map(|c| u64::from(a[c].abs_diff(b[c]))).sum::<u64>();
        count += 3;
    }
    #[allow(
        clippy::cast_precision_loss,
        reason = "sums of grey levels are far below 2^53"
    )]
    let mean = sum as f64 / count.max(1) as f64;
    mean
}
