//! Where depth maps come from: asked for one view at a time, so that they need not all be in
//! memory.

use super::Estimate;
use crate::error::{Error, Result};
use mvs_datasets::scene::{
    ColorImage, DepthMap, Distortion, Mask, NormalMap, Raster, View, Window,
};
use std::collections::BTreeSet;
use std::ops::Range;
use std::sync::{Arc, Mutex, PoisonError};

/// Depth maps with their views, confidence and images. Views are numbered from 0.
///
/// The same call answers the same every time. Calls come from several threads.
pub trait DepthMaps: Sync {
    /// How many views there are.
    fn count(&self) -> usize;
    /// A view with the camera for the size of its depth map.
    fn view(&self, index: usize) -> &View;
    /// The numbers of the view's source views, best first.
    fn sources(&self, index: usize) -> &[usize];
    /// The estimated z-depth.
    ///
    /// # Errors
    /// What stands in the way of reading it.
    fn depth(&self, index: usize) -> Result<DepthMap>;
    /// Calls `take(row, first column, depths)` for runs of columns of [`DepthMaps::depth`], row by row from the
    /// top or the bottom, after a check of its size. Where there is no run, there is no depth.
    ///
    /// # Errors
    /// As [`DepthMaps::depth`], and a map that does not have its camera's size.
    fn depth_runs(&self, index: usize, take: &mut dyn FnMut(usize, usize, &[f32])) -> Result<()> {
        let depth = self.depth(index)?;
        check_size(self.view(index), depth.size(), "depth map")?;
        take_rows(&depth, take);
        Ok(())
    }
    /// Confidence per pixel, of the depth map's size.
    ///
    /// # Errors
    /// What stands in the way of reading it.
    fn confidence(&self, index: usize) -> Result<Option<Raster<f32>>>;
    /// Puts of every row of [`DepthMaps::confidence`] the `wanted` columns where they belong in `to`, which is
    /// row-major and of the depth map's size; false without confidence.
    ///
    /// # Errors
    /// As [`DepthMaps::confidence`], and a map that does not have its camera's size.
    fn confidence_parts(
        &self,
        index: usize,
        wanted: &dyn Fn(usize) -> Range<usize>,
        to: &mut [f32],
    ) -> Result<bool> {
        let confidence = self.confidence(index)?;
        if let Some(confidence) = &confidence {
            check_size(self.view(index), confidence.size(), "confidence")?;
        }
        Ok(put_parts(confidence.as_ref(), wanted, to))
    }
    /// Which pixels count, of the depth map's size.
    ///
    /// # Errors
    /// What stands in the way of reading it.
    fn mask(&self, _index: usize) -> Result<Option<Mask>> {
        Ok(None)
    }
    /// Normals in the camera frame, of the depth map's size.
    ///
    /// # Errors
    /// What stands in the way of reading them.
    fn normals(&self, _index: usize) -> Result<Option<NormalMap>> {
        Ok(None)
    }
    /// The photograph, of any size.
    ///
    /// # Errors
    /// What stands in the way of reading it.
    fn image(&self, index: usize) -> Result<Option<ColorImage>>;
    /// The width and height of [`DepthMaps::image`], and of it what lies in the window that `wanted` answers
    /// to them.
    ///
    /// # Errors
    /// As [`DepthMaps::image`], and a window that is empty or reaches beyond the image.
    fn image_part(
        &self,
        index: usize,
        wanted: &dyn Fn((u32, u32)) -> Window,
    ) -> Result<Option<((u32, u32), ColorImage)>> {
        let part = |image: ColorImage| {
            let size = image.size();
            Ok((size, image.cut(&wanted(size))?))
        };
        self.image(index)?.map(part).transpose()
    }
    /// Whether every view has an image.
    fn has_images(&self) -> bool;
    /// Whether every view has confidence.
    fn has_confidence(&self) -> bool;
}

/// Calls `take(row, first column, depths)` for the runs of 64 columns in which there are depths.
pub(crate) fn take_rows(depth: &DepthMap, take: &mut dyn FnMut(usize, usize, &[f32])) {
    for (row, depths) in depth.raster().rows().enumerate() {
        for (run, depths) in depths.chunks(RUN).enumerate() {
            if depths.iter().any(|&depth| depth > 0.0) {
                take(row, run * RUN, depths);
            }
        }
    }
}

const RUN: usize = 64;

/// Puts the `wanted` columns of every row where they belong in `to`; false without a map.
pub(crate) fn put_parts(
    map: Option<&Raster<f32>>,
    wanted: &dyn Fn(usize) -> Range<usize>,
    to: &mut [f32],
) -> bool {
    let Some(map) = map else {
        return false;
    };
    for (row, values) in map.rows().enumerate() {
        let wanted = wanted(row);
        to[row * values.len()..][wanted.clone()].copy_from_slice(&values[wanted]);
    }
    true
}

impl DepthMaps for &[Estimate] {
    fn count(&self) -> usize {
        <[Estimate]>::len(self)
    }

    fn view(&self, index: usize) -> &View {
        &self[index].view
    }

    fn sources(&self, index: usize) -> &[usize] {
        &self[index].sources
    }

    fn depth(&self, index: usize) -> Result<DepthMap> {
        Ok(self[index].depth.clone())
    }

    fn confidence(&self, index: usize) -> Result<Option<Raster<f32>>> {
        Ok(self[index].confidence.clone())
    }

    fn image(&self, index: usize) -> Result<Option<ColorImage>> {
        Ok(self[index].image.clone())
    }

    fn has_images(&self) -> bool {
        self.iter().all(|estimate| estimate.image.is_some())
    }

    fn has_confidence(&self) -> bool {
        self.iter().all(|estimate| estimate.confidence.is_some())
    }
}

/// Where the maps between two passes are kept, by key: in memory, or in files.
pub trait Scratch: Sync {
    /// Keeps `values` under `key`, in place of what was there.
    ///
    /// # Errors
    /// What stands in the way of keeping them.
    fn store(&self, key: u64, values: Vec<f32>) -> Result<()>;
    /// What was stored under `key`.
    ///
    /// # Errors
    /// A key under which nothing is stored, and what stands in the way of reading it.
    fn fetch(&self, key: u64) -> Result<Arc<Vec<f32>>>;
    /// Puts the values in `range` of what was stored under `key` into `to`, in place of what it held.
    ///
    /// # Errors
    /// As [`Scratch::fetch`], and a range that reaches beyond what was stored.
    fn fetch_part(&self, key: u64, range: Range<usize>, to: &mut Vec<f32>) -> Result<()>;
    /// Forgets `key`.
    ///
    /// # Errors
    /// What stands in the way of removing it.
    fn discard(&self, key: u64) -> Result<()>;
}

/// Keeps everything in memory.
#[derive(Debug, Default)]
pub struct MemoryScratch {
    maps: Mutex<std::collections::BTreeMap<u64, Arc<Vec<f32>>>>,
}

impl MemoryScratch {
    fn maps(&self) -> std::sync::MutexGuard<'_, std::collections::BTreeMap<u64, Arc<Vec<f32>>>> {
        self.maps.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Scratch for MemoryScratch {
    fn store(&self, key: u64, values: Vec<f32>) -> Result<()> {
        self.maps().insert(key, Arc::new(values));
        Ok(())
    }

    fn fetch(&self, key: u64) -> Result<Arc<Vec<f32>>> {
        let found = self.maps().get(&key).cloned();
        found.ok_or_else(|| Error::invalid("scratch", format!("expected a map {key}, found none")))
    }

    fn fetch_part(&self, key: u64, range: Range<usize>, to: &mut Vec<f32>) -> Result<()> {
        let all = self.fetch(key)?;
        let part = all.get(range.clone()).ok_or_else(|| {
            let problem = format!("expected numbers {range:?}, found {}", all.len());
            Error::invalid(format!("scratch map {key}"), problem)
        })?;
        to.clear();
        to.extend_from_slice(part);
        Ok(())
    }

    fn discard(&self, key: u64) -> Result<()> {
        self.maps().remove(&key);
        Ok(())
    }
}

/// Checks what can be checked without reading a map: there are views, and sources are other views.
pub(super) fn check_views(maps: &dyn DepthMaps) -> Result<()> {
    if maps.count() == 0 {
        let problem = "expected at least one, found none: nothing to fuse";
        return Err(Error::invalid("depth maps", problem));
    }
    for index in 0..maps.count() {
        check_places(maps.view(index))?;
        check_pinhole(maps.view(index))?;
        let odd = |&&source: &&usize| source >= maps.count() || source == index;
        if let Some(source) = maps.sources(index).iter().find(odd) {
            let problem = format!(
                "expected its sources to be other estimates (below {}), found {source}",
                maps.count()
            );
            return Err(Error::invalid(name(maps.view(index)), problem));
        }
        let mut seen = BTreeSet::new();
        if let Some(source) = maps
            .sources(index)
            .iter()
            .find(|&&source| !seen.insert(source))
        {
            let problem = format!("expected distinct sources, found {source} twice");
            return Err(Error::invalid(name(maps.view(index)), problem));
        }
    }
    Ok(())
}

/// Checks that a map of `view` has its camera's size.
pub(super) fn check_size(view: &View, found: (u32, u32), map: &str) -> Result<()> {
    let camera = (view.camera.width(), view.camera.height());
    if found == camera {
        return Ok(());
    }
    let problem = format!(
        "expected a {map} of the camera's size {}x{}, found {}x{}: scale the camera to the map",
        camera.0, camera.1, found.0, found.1
    );
    Err(Error::invalid(name(view), problem))
}

/// Checks that the places of a bordered map fit into 32 bits, in which the loop counts them.
fn check_places(view: &View) -> Result<()> {
    let (width, height) = (view.camera.width(), view.camera.height());
    if (u64::from(width) + 4) * (u64::from(height) + 2) < 1 << 32 {
        return Ok(());
    }
    let problem = format!("expected fewer than 2^32 pixels, found {width}x{height}");
    Err(Error::invalid(name(view), problem))
}

/// Checks that no lens bends a view's rays, which no mode takes into account everywhere.
fn check_pinhole(view: &View) -> Result<()> {
    if view.camera.distortion() == Distortion::None {
        return Ok(());
    }
    let problem = "expected a pinhole camera, found a lens: undistort depth map and image first";
    Err(Error::invalid(name(view), problem))
}

fn name(view: &View) -> String {
    format!("view {}", view.id)
}
