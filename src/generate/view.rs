//! One view: render, blend, write, and remember what was written.

use super::likeness;
use super::masked;
use super::order::{self, Extent};
use super::plan;
use super::range::{self, RangeRule};
use super::visibility;
use super::{Extra, Fit, GenerateOptions, Source};
use crate::blend::{self, Blender};
use crate::error::{Error, Result};
use crate::provenance;
use crate::render::{RenderOptions, Renderer, Rendering, Sight};
use mvs_datasets::format::image::{self, JpegOptions};
use mvs_datasets::format::pfm;
use mvs_datasets::layout::blended::BlendedFolder;
use mvs_datasets::layout::blended::record::{self, Encoding, ViewRecord};
use mvs_datasets::layout::files;
use mvs_datasets::scene::{ColorImage, DepthMap, DepthRange, Mask, View};
use std::collections::BTreeMap;
use std::io::Write;
use std::path::{Path, PathBuf};

/// What is needed to finish any view of a scene.
pub(super) struct ViewWork<'a> {
    pub(super) source: &'a Source<'a>,
    pub(super) renderer: &'a Renderer<'a>,
    pub(super) folder: &'a BlendedFolder,
    pub(super) options: &'a GenerateOptions,
    pub(super) scene_digest: &'a str,
    /// A blender for each image size of the set's views.
    pub(super) blenders: &'a BTreeMap<(u32, u32), Blender>,
}

/// A warning: code and sentence.
type Coded = (String, String);

/// The images of one view, of one size.
struct Images {
    photograph: ColorImage,
    /// Pixels that the photograph does not show; its border stands there.
    beyond: usize,
    rendering: Rendering,
    mask: Mask,
    /// As [`likeness::likeness`].
    likeness: Option<f64>,
    blended: ColorImage,
}

/// Refuses a quality that no JPEG has.
pub(super) fn check_jpeg_quality(quality: u8) -> Result<()> {
    if (1..=100).contains(&quality) {
        return Ok(());
    }
    let problem = format!("expected 1 to 100, found {quality}");
    Err(Error::invalid("JPEG quality", problem))
}

impl ViewWork<'_> {
    /// Makes the files of a view (as given, fitted), unless they are there and follow from the same
    /// inputs.
    pub(super) fn finish(&self, views: (&View, &View), watchers: &[View]) -> Result<ViewRecord> {
        // Before the photograph is read: one that is exchanged meanwhile is another one next time.
        let plan = self.digest(views, watchers)?;
        let (given, fitted) = views;
        if let Some(record) = finished(self.folder, &record_path(self.folder, fitted.id), &plan) {
            return Ok(record);
        }
        let images = self.images(given, fitted)?;
        let record = self.write((fitted, plan), &images, watchers)?;
        record::write_json(&record_path(self.folder, fitted.id), &record)?;
        Ok(record)
    }

    /// The record of a finished view, if its files are there and follow from the same inputs.
    pub(super) fn find(
        &self,
        views: (&View, &View),
        watchers: &[View],
    ) -> Result<Option<ViewRecord>> {
        let path = record_path(self.folder, views.1.id);
        Ok(finished(self.folder, &path, &self.digest(views, watchers)?))
    }

    fn digest(&self, views: (&View, &View), watchers: &[View]) -> Result<String> {
        plan::view_digest(self.scene_digest, views, self.source.photographs, watchers)
    }

    /// Renders and blends.
    fn images(&self, given: &View, fitted: &View) -> Result<Images> {
        let extras = &self.options.extras;
        let render = RenderOptions {
            normals: extras.contains(&Extra::Normals) || extras.contains(&Extra::Occlusion),
            interpolated_normals: extras.contains(&Extra::InterpolatedNormals),
            ..self.options.render.clone()
        };
        let rendering = self.renderer.render(fitted, &render)?;
        let photograph = self.source.photographs.photograph(given, &rendering)?;
        let turned = || match self.source.photographs.orientation(given) {
            Some(turn) => format!(" (its file has EXIF orientation {turn}; pixels are as stored)"),
            None => String::new(),
        };
        let named = |error| {
            let (view, turned) = (format!("view {}", given.id), turned());
            Error::invalid(view, format!("{error}{turned}"))
        };
        let fit = Fit::undistorting(&given.camera, self.options.size)?;
        let (photograph, beyond) = fit.image(photograph).map_err(named)?;
        let mask = rendering.depth.valid_mask();
        let blended = match self.blenders.get(&mask.size()) {
            Some(blender) => blender.blend(&rendering.color, &photograph, &mask)?,
            None => blend::blend(&rendering.color, &photograph, &mask, &self.options.blend)?,
        };
        Ok(Images {
            likeness: likeness::likeness(&rendering.color, &photograph, &mask),
            photograph,
            beyond,
            rendering,
            mask,
            blended,
        })
    }

    /// The view's depth range, how many depths readers keep of it, and a warning where the wanted rule
    /// left nothing inside or lost what it is there to keep.
    fn range(
        &self,
        view: &View,
        (depth, extent): (&DepthMap, Extent),
    ) -> Result<(DepthRange, usize, Option<Coded>)> {
        let (rule, margin) = (self.options.range, self.options.range_margin);
        let range = range::range_within(depth, extent, rule, margin)?;
        let (kept, all) = (range::kept_by_readers(depth, &range), extent.count);
        if kept > 0 {
            let lost = rule == RangeRule::Widened && kept < all;
            let warning = lost.then(|| {
                let message = format!(
                    "view {}: readers lose {} of {all} depths, which reach from {} to {}: no range \
                     holds more than a ratio of about 124",
                    view.id,
                    all - kept,
                    extent.smallest,
                    extent.largest
                );
                ("depth-lost".to_owned(), message)
            });
            return Ok((range, kept, warning));
        }
        let widened = range::range_within(depth, extent, RangeRule::Widened, margin)?;
        let warning = format!(
            "view {} has no depth inside its range {} to {}; it was widened to {} to {}",
            view.id,
            range.min(),
            range.max(),
            widened.min(),
            widened.max()
        );
        let kept = range::kept_by_readers(depth, &widened);
        Ok((widened, kept, Some(("range-widened".to_owned(), warning))))
    }

    /// Writes all files of the view.
    fn write(
        &self,
        (view, plan): (&View, String),
        images: &Images,
        watchers: &[View],
    ) -> Result<ViewRecord> {
        let (folder, id, rendering) = (self.folder, view.id, &images.rendering);
        let jpeg = JpegOptions {
            quality: self.options.jpeg_quality,
            subsample_chroma: !self.options.full_chroma,
        };
        let depth = &rendering.depth;
        let extent = order::extent(depth).ok_or_else(|| no_surface(view))?;
        let (range, kept, warning) = self.range(view, (depth, extent))?;
        let ranged = View {
            depth_range: Some(range),
            ..view.clone()
        };
        let masked_jpeg = write_images(folder, id, images, jpeg)?;
        folder.write_depth(id, depth)?;
        folder.write_cam(&ranged, self.options.pixel_centre)?;
        let mut written = vec![
            folder.image(id),
            folder.masked_image(id),
            folder.depth(id),
            folder.cam(id),
        ];
        for extra in &self.options.extras {
            written.extend(self.write_extra(*extra, view, images, watchers)?);
        }
        Ok(ViewRecord {
            id,
            name: view.name.clone(),
            plan,
            size: depth.size(),
            depth: (extent.smallest, extent.largest),
            range: (range.min(), range.max()),
            surface: extent.count,
            kept_by_readers: kept,
            back_faces: rendering.count(Sight::BackFace),
            likeness: images.likeness,
            masked_jpeg,
            files: hashes(folder.path(), &written)?,
            warnings: (warning.into_iter())
                .chain(beyond_warning(id, images))
                .collect(),
        })
    }

    fn write_extra(
        &self,
        extra: Extra,
        view: &View,
        images: &Images,
        watchers: &[View],
    ) -> Result<Vec<PathBuf>> {
        let (folder, id, rendering) = (self.folder, view.id, &images.rendering);
        let path = match extra {
            Extra::InputImages => {
                let path = folder.input_image(id);
                BlendedFolder::write_jpeg(&path, &images.photograph, JpegOptions::default())?;
                path
            }
            Extra::RenderedImages => {
                let path = folder.rendered_image(id);
                BlendedFolder::write_png(&path, &rendering.color)?;
                path
            }
            Extra::Masks => {
                let path = folder.mask(id);
                BlendedFolder::write_mask(&path, &images.mask)?;
                path
            }
            Extra::DepthEdges => {
                let path = folder.depth_edges(id);
                let edges = visibility::depth_edges(&rendering.depth, DEPTH_JUMP)?;
                BlendedFolder::write_mask(&path, &edges)?;
                path
            }
            Extra::Normals => {
                if let Some(normals) = &rendering.normals {
                    folder.write_normals(id, normals)?;
                }
                folder.normals(id)
            }
            Extra::InterpolatedNormals => {
                let path = folder.interpolated_normals(id);
                if let Some(normals) = &rendering.interpolated_normals {
                    files::write_atomically(&path, |out| pfm::write_color(out, normals))?;
                }
                path
            }
            Extra::Sight => {
                let path = folder.sight(id);
                let levels = rendering.sight.map(|sight| sight.level());
                files::write_atomically(&path, |out| image::write_gray_png(out, &levels))?;
                path
            }
            Extra::Occlusion => return self.write_occlusion(view, rendering, watchers),
            Extra::Covisibility | Extra::Transforms | Extra::Colmap => return Ok(Vec::new()),
        };
        Ok(vec![path])
    }

    fn write_occlusion(
        &self,
        view: &View,
        rendering: &Rendering,
        watchers: &[View],
    ) -> Result<Vec<PathBuf>> {
        let write = |source: &View| {
            let path = self.folder.occlusion(view.id, source.id);
            let seen = visibility::occlusion(self.renderer, (view, rendering), source)?;
            files::write_atomically(&path, |out| image::write_gray_png(out, &seen))?;
            Ok(path)
        };
        watchers.iter().map(write).collect()
    }
}

/// Writes the blended image, and what the mask leaves of it; says how that was encoded if not as asked.
fn write_images(
    folder: &BlendedFolder,
    id: u32,
    images: &Images,
    jpeg: JpegOptions,
) -> Result<Option<Encoding>> {
    let (blended, mask) = (&images.blended, &images.mask);
    let pair = masked::encode(blended, mask, jpeg)?;
    let (whole, used) = (&pair.whole, pair.used);
    let masked = pair.masked.as_ref().unwrap_or(whole);
    files::write_atomically(&folder.image(id), |out| out.write_all(whole))?;
    files::write_atomically(&folder.masked_image(id), |out| out.write_all(masked))?;
    Ok((used != jpeg).then_some(Encoding {
        quality: used.quality,
        full_chroma: !used.subsample_chroma,
    }))
}

/// A warning where the photograph does not cover the render.
fn beyond_warning(id: u32, images: &Images) -> Option<Coded> {
    let all = images.photograph.values().len();
    (images.beyond > 0).then(|| {
        let percent = 100.0 * images.beyond as f64 / all as f64;
        let message = format!(
            "view {id}: {percent:.1} % of the render's pixels lie beyond the photograph, whose border is repeated \
             there: its lens bends that part of the view away"
        );
        ("beyond-photograph".to_owned(), message)
    })
}

/// A depth edge is a jump by more than this fraction of the nearer depth.
const DEPTH_JUMP: f32 = 0.02;

/// Where the record of a finished view stands.
pub(super) fn record_path(folder: &BlendedFolder, id: u32) -> PathBuf {
    folder.path().join("views").join(format!("{id:08}.json"))
}

/// The record at `path` if it is of the same plan and its files are what it says.
fn finished(folder: &BlendedFolder, path: &Path, digest: &str) -> Option<ViewRecord> {
    let record: ViewRecord = record::read_json(path).ok()??;
    let unchanged = |(name, hash): (&String, &String)| {
        provenance::hash_path(&folder.path().join(name)).is_ok_and(|now| now == *hash)
    };
    (record.plan == digest && record.files.iter().all(unchanged)).then_some(record)
}

/// Why a view without depth cannot be finished.
fn no_surface(view: &View) -> Error {
    let problem = "expected rendered surface at some pixel centre, found none";
    Error::invalid(format!("view {}", view.id), problem)
}

/// BLAKE3 of each path, by its path in `root`.
fn hashes(root: &Path, paths: &[PathBuf]) -> Result<BTreeMap<String, String>> {
    let hash = |path: &PathBuf| {
        let inside = path.strip_prefix(root).unwrap_or(path);
        let name = inside.to_string_lossy().replace('\\', "/");
        Ok((name, provenance::hash_path(path)?))
    };
    paths.iter().map(hash).collect()
}
