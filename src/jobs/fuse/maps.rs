//! A folder of depth maps, read one at a time.

use super::units::{self, Units};
use super::{FuseJob, cams, confidences, workspace};
use crate::error::{Error, Result};
use crate::fuse::{DepthMaps, Scratch, put_parts, take_rows};
use crate::generate;
use crate::jobs::Context;
use crate::provenance::Inputs;
use crate::warning::Warnings;
use mvs_datasets::FormatError;
use mvs_datasets::format::colmap::dense;
use mvs_datasets::format::{image, pfm};
use mvs_datasets::layout::files;
use mvs_datasets::layout::mvsnet;
use mvs_datasets::layout::scratch::ScratchFolder;
use mvs_datasets::layout::workspace::Workspace;
use mvs_datasets::scene::{
    ColorImage, DepthMap, Mask, NormalMap, Raster, RejectedDepths, View, Window,
};
use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// The views of a scene that have a depth map.
pub(super) struct FolderMaps<'a> {
    entries: Vec<Entry>,
    has_images: bool,
    has_confidence: bool,
    warnings: &'a Warnings,
    /// Photographs that EXIF says are to be turned, with the orientation, as far as they have been read.
    turned: Mutex<BTreeMap<PathBuf, u8>>,
    /// Depth maps without any depth, as far as they have been read.
    empty: Mutex<BTreeSet<PathBuf>>,
    /// What the depths of the first view with a depth range look like, if they have been read.
    units: Mutex<Units>,
    /// All that is read: the views' files are hashed as they are, all others before.
    pub(super) inputs: Inputs,
}

/// The files of one view.
pub(super) struct Entry {
    /// With the camera for the depth map's size.
    pub(super) view: View,
    pub(super) sources: Vec<usize>,
    /// The view's place among all of the scene, whether they have a depth map or not: in a workspace that
    /// by which COLMAP counts, asked for only where `.vis` is written.
    pub(super) number: u32,
    pub(super) encoding: Encoding,
    /// See [`usual_depth`](super::coordinates::usual_depth).
    pub(super) usual_depth: Option<f32>,
    pub(super) depth: PathBuf,
    pub(super) normals: Option<PathBuf>,
    pub(super) confidence: Vec<PathBuf>,
    pub(super) mask: Option<PathBuf>,
    pub(super) image: Option<PathBuf>,
}

/// How depth and normals are written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Encoding {
    /// PFM.
    Pfm,
    /// COLMAP's dense arrays.
    Dense,
}

impl<'a> FolderMaps<'a> {
    /// Finds the files of `job` and reads the headers of its depth maps. The files of the result, `own` and
    /// the filtered depths, are no inputs.
    pub(super) fn open(job: &FuseJob, own: &[PathBuf], context: &Context<'a>) -> Result<Self> {
        let workspace = Workspace::at(&job.scene).filter(|_| job.depths.as_os_str().is_empty());
        let entries = match &workspace {
            Some(workspace) => workspace::entries(job, workspace, context)?,
            None => cams::entries(job, context)?,
        };
        warn_of_missing(&entries, context);
        let inputs = job.inputs()?;
        let inputs: Vec<&Path> = inputs.iter().map(PathBuf::as_path).collect();
        context.warn_of_unfinished(&inputs, &job.out);
        let own = [own, &filtered_paths(job, &entries)].concat();
        let maps = Self {
            inputs: Inputs::list(&inputs, &own)?,
            has_images: entries.iter().all(|entry| entry.image.is_some()),
            has_confidence: !job.confidence.is_empty(),
            entries,
            warnings: context.warnings,
            turned: Mutex::default(),
            empty: Mutex::default(),
            units: Mutex::default(),
        };
        if workspace.is_none() {
            cams::warn_of_strays(job, (&maps.inputs.files(), &maps.entries), context);
        }
        maps.hash_others()?;
        Ok(maps)
    }

    /// The files of the filtered depths, if they are asked for.
    pub(super) fn filtered(&self, job: &FuseJob) -> Vec<PathBuf> {
        filtered_paths(job, &self.entries)
    }

    /// Hashes the inputs that are not maps and images of the views, which are hashed as they are read.
    pub(super) fn hash_others(&self) -> Result<()> {
        self.inputs.hash_others(&self.of_views())
    }

    /// The views' maps and images.
    fn of_views(&self) -> BTreeSet<&Path> {
        let mut files = BTreeSet::new();
        for entry in &self.entries {
            let maybe = [&entry.normals, &entry.mask, &entry.image];
            files.extend(maybe.into_iter().filter_map(|path| path.as_deref()));
            files.extend(entry.confidence.iter().map(PathBuf::as_path));
            files.insert(entry.depth.as_path());
        }
        files
    }

    /// The files that are read, and all others that lie among the inputs.
    pub(super) fn files(&self) -> Vec<&Path> {
        let mut files: Vec<&Path> = self.of_views().into_iter().collect();
        files.extend(self.inputs.files());
        files
    }

    /// Pixels of all depth maps.
    pub(super) fn pixels(&self) -> u64 {
        let pixels = |entry: &Entry| {
            u64::from(entry.view.camera.width()) * u64::from(entry.view.camera.height())
        };
        self.entries.iter().map(pixels).sum()
    }
}

fn filtered_paths(job: &FuseJob, entries: &[Entry]) -> Vec<PathBuf> {
    let path =
        |folder: &PathBuf, entry: &Entry| folder.join(mvsnet::file_name(entry.view.id, ".pfm"));
    let folder = job.filtered_depths.iter();
    folder
        .flat_map(|folder| entries.iter().map(move |entry| path(folder, entry)))
        .collect()
}

/// Without all images there are no colours, and normals are fitted where none are given: says so where some are
/// there.
fn warn_of_missing(entries: &[Entry], context: &Context<'_>) {
    let warn = |has: fn(&Entry) -> bool, (code, what, so): (&str, &str, &str)| {
        let mut missing = entries.iter().filter(|entry| !has(entry));
        let (count, all) = (missing.clone().count(), entries.len());
        if let Some(first) = missing.next()
            && count < all
        {
            let first = first.view.id;
            let message =
                format!("{count} of {all} views have no {what}, the first is view {first}: {so}");
            context.warnings.add(code, message);
        }
    };
    let colors = ("missing-image", "image", "points get no colours");
    warn(|entry| entry.image.is_some(), colors);
    let normals = (
        "missing-normals",
        "normal map",
        "theirs are fitted to depths",
    );
    warn(|entry| entry.normals.is_some(), normals);
}

impl DepthMaps for FolderMaps<'_> {
    fn count(&self) -> usize {
        self.entries.len()
    }

    fn view(&self, index: usize) -> &View {
        &self.entries[index].view
    }

    fn sources(&self, index: usize) -> &[usize] {
        &self.entries[index].sources
    }

    fn depth(&self, index: usize) -> Result<DepthMap> {
        let (path, encoding) = (&self.entries[index].depth, self.entries[index].encoding);
        let (depth, rejected) = match encoding {
            Encoding::Pfm => DepthMap::clean(self.read(path, pfm::read_gray)?),
            Encoding::Dense => DepthMap::clean(self.read(path, dense::read_gray)?),
        };
        self.warn_of(path, rejected);
        if !depth.values().iter().any(|&depth| depth > 0.0) {
            self.note_empty(path);
        }
        Ok(depth)
    }

    fn depth_runs(&self, index: usize, take: &mut dyn FnMut(usize, usize, &[f32])) -> Result<()> {
        let Entry { view, depth, .. } = &self.entries[index];
        let size = (view.camera.width(), view.camera.height());
        match self.entries[index].encoding {
            Encoding::Pfm => {
                let mut all = RejectedDepths::default();
                let mut units = Units::default();
                let range = view.depth_range.filter(|_| self.judged() == Some(index));
                let mut is_empty = true;
                let clean = |row, first, values: &mut [f32]| {
                    all.add(DepthMap::clean_values(values));
                    is_empty = is_empty && !values.iter().any(|&depth| depth > 0.0);
                    if let Some(range) = range {
                        units.add(range, values);
                    }
                    take(row, first, values);
                };
                self.read_through(depth, |bytes, passed| {
                    pfm::gray_runs(bytes, size, clean, passed)
                })?;
                if range.is_some() {
                    *self.units() = units;
                }
                self.warn_of(depth, all);
                if is_empty {
                    self.note_empty(depth);
                }
            }
            Encoding::Dense => take_rows(&self.depth(index)?, take),
        }
        Ok(())
    }

    fn confidence(&self, index: usize) -> Result<Option<Raster<f32>>> {
        let camera = &self.entries[index].view.camera;
        let size = (camera.width(), camera.height());
        let paths = &self.entries[index].confidence;
        let read = |path: &PathBuf| self.read(path, pfm::read_gray);
        let maps = paths.iter().map(read).collect::<Result<Vec<_>>>()?;
        let is_larger = |map: &Raster<f32>| map.width() > size.0 || map.height() > size.1;
        for (path, map) in paths.iter().zip(&maps).filter(|(_, map)| is_larger(map)) {
            self.check_size(index, path, map.size())?;
        }
        // One at least is as large as the depth map, to which the others are brought.
        if let (Some(path), Some(first)) = (paths.first(), maps.first())
            && maps.iter().all(|map| map.size() != size)
        {
            self.check_size(index, path, first.size())?;
        }
        Ok(confidences::smallest(maps, size))
    }

    fn confidence_parts(
        &self,
        index: usize,
        wanted: &dyn Fn(usize) -> Range<usize>,
        to: &mut [f32],
    ) -> Result<bool> {
        let camera = &self.entries[index].view.camera;
        let size = (camera.width(), camera.height());
        let [only] = self.entries[index].confidence.as_slice() else {
            return Ok(put_parts(self.confidence(index)?.as_ref(), wanted, to));
        };
        let mut found = size;
        self.read_through(only, |bytes, passed| {
            found = pfm::read_size(bytes)?;
            if found == size {
                return pfm::gray_parts(bytes, size, wanted, to, passed);
            }
            passed(bytes); // that it is another size is said below
            Ok(())
        })?;
        self.check_size(index, only, found)?;
        Ok(true)
    }

    fn normals(&self, index: usize) -> Result<Option<NormalMap>> {
        let Some(path) = &self.entries[index].normals else {
            return Ok(None);
        };
        let normals = self.read(path, dense::read_normals)?;
        self.check_size(index, path, normals.size())?;
        let finite = |normal: &[f32; 3]| normal.iter().all(|axis| axis.is_finite());
        let odd = normals
            .values()
            .iter()
            .filter(|normal| !finite(normal))
            .count();
        if odd > 0 {
            let message = format!(
                "{}: {odd} normals that are not finite count as none",
                path.display()
            );
            self.warnings.add("bad-normal", message);
        }
        Ok(Some(normals))
    }

    fn mask(&self, index: usize) -> Result<Option<Mask>> {
        let Some(path) = &self.entries[index].mask else {
            return Ok(None);
        };
        let gray = self.read(path, image::read_gray)?;
        self.check_size(index, path, gray.size())?;
        Ok(Some(gray.map(|&value| value >= 128)))
    }

    fn image(&self, index: usize) -> Result<Option<ColorImage>> {
        let path = self.entries[index].image.as_ref();
        let read = |path: &PathBuf| {
            self.read(path, |bytes| {
                self.note_turned(path, bytes);
                image::read_color(bytes)
            })
        };
        path.map(read).transpose()
    }

    fn image_part(
        &self,
        index: usize,
        wanted: &dyn Fn((u32, u32)) -> Window,
    ) -> Result<Option<((u32, u32), ColorImage)>> {
        let path = self.entries[index].image.as_ref();
        let read = |path: &PathBuf| {
            self.read(path, |bytes| {
                self.note_turned(path, bytes);
                image::read_color_part(bytes, wanted)
            })
        };
        path.map(read).transpose()
    }

    fn has_images(&self) -> bool {
        self.has_images
    }

    fn has_confidence(&self) -> bool {
        self.has_confidence
    }
}

impl FolderMaps<'_> {
    /// Maps a file for `read`, and has it hashed when it is read for the first time.
    fn read<T>(
        &self,
        path: &Path,
        read: impl FnOnce(&[u8]) -> std::result::Result<T, FormatError>,
    ) -> Result<T> {
        self.read_through(path, |bytes, passed| {
            passed(bytes);
            read(bytes)
        })
    }

    /// As [`FolderMaps::read`], where `read` hands on all bytes itself, soon after it looked at them.
    fn read_through<T>(
        &self,
        path: &Path,
        read: impl FnOnce(&[u8], &mut dyn FnMut(&[u8])) -> std::result::Result<T, FormatError>,
    ) -> Result<T> {
        let mut reading = self.inputs.reading(path);
        let value = files::read_with(path, |bytes| {
            read(bytes, &mut |piece| reading.passed(piece))
        })?;
        reading.done();
        Ok(value)
    }

    fn warn_of(&self, path: &Path, rejected: RejectedDepths) {
        if rejected.total() == 0 {
            return;
        }
        let message = format!(
            "{}: {} NaN, {} infinite and {} negative depths count as none",
            path.display(),
            rejected.nan,
            rejected.infinite,
            rejected.negative
        );
        self.warnings.add("bad-depth", message);
    }

    fn note_empty(&self, path: &Path) {
        let mut empty = self.empty.lock().unwrap_or_else(PoisonError::into_inner);
        empty.insert(path.to_path_buf());
    }

    /// Says which of the depth maps that were read hold no depth at all.
    pub(super) fn warn_of_empty(&self) {
        let empty = self.empty.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(first) = empty.first() {
            let (count, all) = (empty.len(), self.entries.len());
            let first = first.display();
            let message =
                format!("{count} of {all} depth maps hold no depth, the first is {first}");
            self.warnings.add("empty-depth", message);
        }
    }

    fn note_turned(&self, path: &Path, bytes: &[u8]) {
        if let Some(orientation) = generate::orientation_in(bytes) {
            let mut turned = self.turned.lock().unwrap_or_else(PoisonError::into_inner);
            turned.insert(path.to_path_buf(), orientation);
        }
    }

    /// Says which of the photographs that were read are stored turned: their pixels are taken as stored.
    pub(super) fn warn_of_turned(&self) {
        let turned = self.turned.lock().unwrap_or_else(PoisonError::into_inner);
        let turned: Vec<(&Path, u8)> = (turned.iter())
            .map(|(path, orientation)| (path.as_path(), *orientation))
            .collect();
        if let Some(warning) = generate::warning_of_turned(&turned) {
            self.warnings.add(&warning.code, warning.message);
        }
    }

    /// The first view with a depth range.
    fn judged(&self) -> Option<usize> {
        let has_range = |entry: &Entry| entry.view.depth_range.is_some();
        self.entries.iter().position(has_range)
    }

    fn units(&self) -> MutexGuard<'_, Units> {
        self.units.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Says so if the depths of the first view with a depth range lie far outside of it, as those in other
    /// units do.
    pub(super) fn warn_of_units(&self) -> Result<()> {
        let Some(index) = self.judged().filter(|_| !self.units().are_usual()) else {
            return Ok(());
        };
        let view = &self.entries[index].view;
        let depth = self.depth(index)?;
        if let Some(problem) = units::problem(view, depth.values()) {
            self.warnings.add("depth-units", problem);
        }
        Ok(())
    }

    /// The least of the views' usual depths; `None` where no view has any.
    pub(super) fn usual_depth(&self) -> Option<f32> {
        let depths = self.entries.iter().filter_map(|entry| entry.usual_depth);
        depths.min_by(f32::total_cmp)
    }

    /// The place among all views of the scene of the view number `index`.
    pub(super) fn number(&self, index: usize) -> u32 {
        self.entries[index].number
    }

    /// Checks that what was read from `path` has the size of the view's depth map.
    fn check_size(&self, index: usize, path: &Path, found: (u32, u32)) -> Result<()> {
        let camera = &self.entries[index].view.camera;
        let expected = (camera.width(), camera.height());
        if found == expected {
            return Ok(());
        }
        let depth = &self.entries[index].depth;
        let problem = format!(
            "expected the size of its depth map {}, which is {}x{}, found {}x{}: one of the two is of \
             another view or resolution",
            depth.display(),
            expected.0,
            expected.1,
            found.0,
            found.1
        );
        Err(Error::invalid(path.display().to_string(), problem))
    }
}

/// Keeps the maps between passes in files.
pub(super) struct FileScratch(pub(super) ScratchFolder);

impl Scratch for FileScratch {
    fn store(&self, key: u64, values: Vec<f32>) -> Result<()> {
        Ok(self.0.store(key, &values)?)
    }

    fn fetch(&self, key: u64) -> Result<Arc<Vec<f32>>> {
        Ok(Arc::new(self.0.fetch(key)?))
    }

    fn fetch_part(&self, key: u64, range: Range<usize>, to: &mut Vec<f32>) -> Result<()> {
        Ok(self.0.fetch_part(key, range, to)?)
    }

    fn discard(&self, key: u64) -> Result<()> {
        Ok(self.0.discard(key)?)
    }
}
