//! Each view by itself: sizes, mask, depth range.

use super::{Finding, median};
use crate::error::Result;
use crate::generate::range::kept_by_readers;
use crate::parallel;
use crate::progress::Progress;
use mvs_datasets::layout::blended::BlendedFolder;
use mvs_datasets::layout::files;
use mvs_datasets::layout::mvsnet::file_name;
use mvs_datasets::scene::{ColorImage, DepthMap, Scene, View};

/// In grey levels: two JPEGs of one image, of quality 75 or better, differ by less, even where every
/// coefficient is rounded (9 levels rms each, the median of whose difference is below this). Another
/// view's image differs by 30 on the scene this was measured on.
const SAME_IMAGE: f64 = 10.0;
/// The brightest that readers take for background.
const DARK: u8 = 10;

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
    let image = match files::read_image(&path) {
        Ok(image) => image,
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

/// The masked image is dark where there is no depth, and the image where there is.
fn check_mask(
    id: u32,
    masked: &ColorImage,
    image: Option<&ColorImage>,
    depth: &DepthMap,
    findings: &mut Vec<Finding>,
) {
    let name = format!("blended_images/{}", file_name(id, "_masked.jpg"));
    let bright = |pixel: &[u8; 3]| pixel.iter().any(|&value| value > DARK);
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
            "expected black where there is no depth, found {bright_outside} of {outside} such pixels above {DARK}: the image is not masked"
        );
        findings.push(Finding::fault("missing-mask", name.clone(), message));
    } else if bright_outside > 0 {
        let message = format!(
            "{bright_outside} of {outside} pixels without depth are above {DARK} (up to {worst}): readers take them for surface"
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
    let inside = pairs.filter(|((_, shown), z)| **z > 0.0 && shown.iter().any(|&v| v > 40));
    let (count, dark) = inside.fold((0usize, 0usize), |(count, dark), ((pixel, _), _)| {
        (count + 1, dark + usize::from(!bright(pixel)))
    });
    if dark * 5 > count {
        let message = format!(
            "expected the image where there is depth, found {dark} of {count} bright pixels black: mask and depth do not belong together"
        );
        findings.push(Finding::fault("wrong-mask", name, message));
    } else if let Some(apart) = apart_inside((masked, image), depth).filter(|&d| d > SAME_IMAGE) {
        let message = format!(
            "expected the image where there is depth, found colours that differ by {apart:.0} grey \
             levels (median): one of the two is another view's"
        );
        findings.push(Finding::fault("masked-differs", name, message));
    }
}

/// The median difference of two images where there is depth, in grey levels.
fn apart_inside((first, second): (&ColorImage, &ColorImage), depth: &DepthMap) -> Option<f64> {
    let pixels = first.values().iter().zip(second.values());
    let inside = pixels.zip(depth.values()).filter(|(_, z)| **z > 0.0);
    let apart = inside.map(|((a, b), _)| {
        let sum: u32 = (0..3).map(|c| u32::from(a[c].abs_diff(b[c]))).sum();
        f64::from(sum) / 3.0
    });
    median(apart.collect())
}
