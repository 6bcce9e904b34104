//! Each view by itself: sizes, mask, depth range.

use super::{Finding, encoded, median};
use crate::error::Result;
use crate::generate::masked::BACKGROUND;
use crate::generate::range::kept_by_readers;
use crate::parallel;
use crate::progress::Progress;
use mvs_datasets::format::image;
use mvs_datasets::layout::blended::BlendedFolder;
use mvs_datasets::layout::files;
use mvs_datasets::layout::mvsnet::file_name;
use mvs_datasets::scene::{ColorImage, DepthMap, Scene, View};

/// In grey levels: two JPEGs of one image, of quality 75 or better, differ by less, even where every
/// coefficient is rounded (9 levels rms each, the median of whose difference is below this). Another
/// view's image differs by 30 on the scene this was measured on.
const SAME_IMAGE: f64 = 10.0;
/// Two JPEGs of one image differ by more at so few pixels with depth: the masked one encoded anew, the worst
/// view of five sound scenes had none of 10 000 at quality 95, 6 at 50 and 43 at 20.
const ANOTHER: f64 = 50.0;
const PAINTED: usize = 50;
/// What no JPEG of a masked image has by itself a little away from the mask.
const BRIGHT: u8 = 40;
/// In pixels. Masked images of sound scenes (10 of 96x72 to 768x576 pixels) have no bright pixel so far from
/// all depth in JPEGs of quality 75 and 95, and at most 10 in 50,000 at quality 50; moved by three pixels,
/// the real one has 400 of 442,368.
const AWAY: u32 = 2;
const TRACE: usize = 4000;
const LEAST_AWAY: usize = 12;
/// Brightness varies by more grey levels (standard deviation) where an image shows any surface.
const FLAT: f64 = 2.0;
/// Pixels by which to judge that: so many, and a hundredth of the image.
const ENOUGH: usize = 100;

pub(super) fn check_views(
    folder: &BlendedFolder,
    scene: &Scene,
    progress: &dyn Progress,
) -> Result<Vec<Finding>> {
    progress.begin("checking views", scene.views().len() as u64);
    let findings = parallel::try_map(scene.views().len(), |index| {
        progress.check()?;
        progress.advance(1);
        Ok(check_view(folder, &scene.views()[index]))
    })?;
    let mut findings: Vec<Finding> = findings.into_iter().flatten().collect();
    if let Some(view) = scene.views().first() {
        let (width, height) = (view.camera.width(), view.camera.height());
        if width * 3 != height * 4 {
            let message = format!("some readers cut images to 4:3; these are {width} x {height}");
            findings.push(Finding::advice("aspect", "all views", message));
        }
    }
    Ok(findings)
}

fn check_view(folder: &BlendedFolder, view: &View) -> Vec<Finding> {
    let mut findings = Vec::new();
    let id = view.id;
    let depth_name = format!("rendered_depth_maps/{}", file_name(id, ".pfm"));
    let depth = match folder.read_depth(id) {
        Ok((depth, rejected)) => {
            if rejected.total() > 0 {
                let message = format!(
                    "expected finite depths of at least 0, found {} others",
                    rejected.total()
                );
                findings.push(Finding::fault("bad-depths", depth_name.clone(), message));
            }
            depth
        }
        Err(_) if !folder.depth(id).exists() => return findings,
        Err(error) => {
            findings.push(Finding::fault("unreadable", depth_name, error.to_string()));
            return findings;
        }
    };
    let size = (view.camera.width(), view.camera.height());
    if depth.size() != size {
        let message = format!(
            "expected the size of the scene's first image, {size:?}, found {:?}: readers take one \
             size for all views",
            depth.size()
        );
        findings.push(Finding::fault("size-mismatch", depth_name.clone(), message));
    }
    check_range(view, &depth, &depth_name, &mut findings);
    let image = sized(folder, (id, ".jpg"), &depth, &mut findings);
    if let Some(image) = &image {
        findings.extend(flat(id, image, &depth));
    }
    let masked = sized(folder, (id, "_masked.jpg"), &depth, &mut findings);
    if let Some(masked) = masked {
        check_mask(id, &masked, image.as_ref(), &depth, &mut findings);
    }
    findings
}

fn check_range(view: &View, depth: &DepthMap, place: &str, findings: &mut Vec<Finding>) {
    let surface = depth.valid_count();
    if surface == 0 {
        let message = "expected some pixel with depth, found none";
        findings.push(Finding::fault("empty-depth", place, message));
        return;
    }
    let Some(range) = view.depth_range else {
        return;
    };
    let kept = kept_by_readers(depth, &range);
    let (min, max) = (range.min(), range.max());
    if kept == 0 {
        let message = format!("expected depths in the cam's range {min} to {max}, found none");
        findings.push(Finding::fault("no-depth-in-range", place, message));
    } else if kept * 10 < surface * 9 {
        let message = format!(
            "{kept} of {surface} depths lie in the part of the range {min} to {max} that readers keep"
        );
        findings.push(Finding::advice("depth-outside-range", place, message));
    }
}

/// The image, if it is there and as large as the depth map.
fn sized(
    folder: &BlendedFolder,
    (id, ending): (u32, &str),
    depth: &DepthMap,
    findings: &mut Vec<Finding>,
) -> Option<ColorImage> {
    let name = format!("blended_images/{}", file_name(id, ending));
    let path = folder.path().join(&name);
    if !path.is_file() {
        return None;
    }
    let read = |bytes: &[u8]| Ok((encoded::check(&name, bytes), image::read_color(bytes)?));
    let image = match files::read_with(&path, read) {
        Ok((found, image)) => {
            findings.extend(found);
            image
        }
        Err(error) => {
            findings.push(Finding::fault("unreadable", name, error.to_string()));
            return None;
        }
    };
    if image.size() != depth.size() {
        let message = format!(
            "expected the size of the depth map, {:?}, found {:?}",
            depth.size(),
            image.size()
        );
        findings.push(Finding::fault("size-mismatch", name, message));
        return None;
    }
    Some(image)
}

/// An image that shows nothing where there is depth: black, or of one colour.
fn flat(id: u32, image: &ColorImage, depth: &DepthMap) -> Option<Finding> {
    let pixels = image.values().iter().zip(depth.values());
    let shown: Vec<f64> = pixels
        .filter(|(_, z)| **z > 0.0)
        .map(|(pixel, _)| brightness(pixel))
        .collect();
    let count = shown.len() as f64;
    let mean = shown.iter().sum::<f64>() / count;
    let spread = (shown.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / count).sqrt();
    (shown.len() >= ENOUGH.max(depth.values().len() / 100) && spread < FLAT).then(|| {
        let message = format!(
            "expected an image of the surface, found brightness that varies by {spread:.1} grey levels \
             around {mean:.0} over the pixels with depth: it is black or of one colour"
        );
        let name = format!("blended_images/{}", file_name(id, ".jpg"));
        Finding::fault("flat-image", name, message)
    })
}

/// Between 0 and 255, by the weights that JPEG has.
fn brightness(pixel: &[u8; 3]) -> f64 {
    let [red, green, blue] = pixel.map(f64::from);
    0.299 * red + 0.587 * green + 0.114 * blue
}

/// Masked and depth belong to the same pixels: nothing bright lies away from all depth.
fn moved(name: &str, masked: &ColorImage, depth: &DepthMap) -> Option<Finding> {
    let (width, height) = depth.size();
    let near = |at: u32, most: u32| at.saturating_sub(AWAY)..(at + AWAY + 1).min(most);
    let is_away = |column: u32, row: u32| {
        near(row, height).all(|r| near(column, width).all(|c| depth.get(c, r) == 0.0))
    };
    let pixels = (0..).zip(masked.values()).zip(depth.values());
    let bright = pixels.filter(|((_, pixel), z)| **z == 0.0 && is_bright(pixel));
    let away = bright.filter(|((index, _), _)| is_away(index % width, index / width));
    let found = away.count();
    let pixels = depth.values().len();
    (found > LEAST_AWAY.max(pixels / TRACE)).then(|| {
        let message = format!(
            "expected black where there is no depth, found {found} of {pixels} pixels above {BRIGHT} that \
             lie more than {AWAY} pixels from any with depth: image and depth are moved against each other"
        );
        Finding::fault("mask-moved", name, message)
    })
}

fn is_bright(pixel: &[u8; 3]) -> bool {
    pixel.iter().any(|&value| value > BRIGHT)
}

/// The masked image is dark where there is no depth, and the image where there is.
fn check_mask(
    id: u32,
    masked: &ColorImage,
    image: Option<&ColorImage>,
    depth: &DepthMap,
    findings: &mut Vec<Finding>,
) {
    let name = format!("blended_images/{}", file_name(id, "_masked.jpg"));
    let bright = |pixel: &[u8; 3]| pixel.iter().any(|&value| value > BACKGROUND);
    let (mut outside, mut bright_outside, mut worst) = (0usize, 0usize, 0u8);
    for (pixel, _) in masked
        .values()
        .iter()
        .zip(depth.values())
        .filter(|(_, z)| **z == 0.0)
    {
        outside += 1;
        bright_outside += usize::from(bright(pixel));
        worst = pixel.iter().fold(worst, |w, &v| w.max(v));
    }
    if bright_outside * 5 > outside {
        let message = format!(
            "expected black where there is no depth, found {bright_outside} of {outside} such pixels above {BACKGROUND}: the image is not masked"
        );
        findings.push(Finding::fault("missing-mask", name.clone(), message));
    } else if let Some(finding) = moved(&name, masked, depth) {
        findings.push(finding);
    } else if bright_outside > 0 {
        let message = format!(
            "{bright_outside} of {outside} pixels without depth are above {BACKGROUND} (up to {worst}): readers take them for surface"
        );
        findings.push(Finding::advice("bright-background", name.clone(), message));
    }
    let Some(image) = image else {
        return;
    };
    let pairs = masked
        .values()
        .iter()
        .zip(image.values())
        .zip(depth.values());
    let inside = pairs.filter(|((_, shown), z)| **z > 0.0 && is_bright(shown));
    let (count, dark) = inside.fold((0usize, 0usize), |(count, dark), ((pixel, _), _)| {
        (count + 1, dark + usize::from(!bright(pixel)))
    });
    if dark * 5 > count {
        let message = format!(
            "expected the image where there is depth, found {dark} of {count} bright pixels black: mask and depth do not belong together"
        );
        findings.push(Finding::fault("wrong-mask", name, message));
    } else if let Some(message) = differs(&apart_inside((masked, image), depth)) {
        findings.push(Finding::fault("masked-differs", name, message));
    }
}

/// What is wrong with a masked image that is so far `apart` from the image where there is depth.
fn differs(apart: &[f64]) -> Option<String> {
    let typical = median(apart.to_vec())?;
    if typical > SAME_IMAGE {
        return Some(format!(
            "expected the image where there is depth, found brightness that differs by {typical:.0} grey \
             levels (median): one of the two is another view's"
        ));
    }
    let (count, all) = (apart.iter().filter(|&&d| d > ANOTHER).count(), apart.len());
    (count * PAINTED > all).then(|| {
        format!(
            "expected the image where there is depth, found brightness that differs by more than {ANOTHER} \
             grey levels at {count} of {all} pixels: in one of the two something is cut out or painted over"
        )
    })
}

/// The differences in brightness of two images where there is depth: colours are coded more coarsely in the
/// one than in the other.
fn apart_inside((first, second): (&ColorImage, &ColorImage), depth: &DepthMap) -> Vec<f64> {
    let pixels = first.values().iter().zip(second.values());
    let inside = pixels.zip(depth.values()).filter(|(_, z)| **z > 0.0);
    let apart = inside.map(|((a, b), _)| (brightness(a) - brightness(b)).abs());
    apart.collect()
}
