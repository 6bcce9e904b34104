//! Points into a PLY as they come, and what stands beside it.

use super::maps::FolderMaps;
use crate::error::{Error, Result};
use crate::fuse::{Columns, DepthMaps, PointSink, Points};
use mvs_datasets::format::pfm;
use mvs_datasets::format::ply::stream::{Scalar, StreamWriter};
use mvs_datasets::layout::scratch::ScratchFolder;
use mvs_datasets::layout::visible::VisibleWriter;
use mvs_datasets::layout::{files, mvsnet};
use mvs_datasets::scene::Raster;
use std::io::{Seek, Write};
use std::path::{Path, PathBuf};

/// Everything that points go to.
pub(super) struct Outputs<'a, W> {
    pub(super) ply: PlySink<W>,
    pub(super) visible: Visible,
    pub(super) depths: Option<DepthFolder>,
    pub(super) maps: &'a FolderMaps<'a>,
}

impl<W: Write + Seek> Outputs<'_, W> {
    /// Writes what is left of them, of which nothing is to be seen yet; the number of points.
    pub(super) fn complete(&mut self) -> Result<u64> {
        if let Visible::Writer(writer) = &mut self.visible {
            writer.complete()?;
        }
        self.ply.complete()
    }

    /// Gives all but the cloud their names.
    pub(super) fn appear(self) -> Result<()> {
        if let Some(depths) = self.depths {
            depths.finish()?;
        }
        match self.visible {
            Visible::Writer(writer) => Ok(writer.finish()?),
            Visible::None => Ok(()),
        }
    }
}

impl<W: Write + Seek> PointSink for Outputs<'_, W> {
    fn take(&mut self, points: &Points) -> Result<()> {
        if let Visible::Writer(writer) = &mut self.visible {
            let mut views = points.visible_in.as_slice();
            for &count in &points.view_counts {
                let (own, others) = views.split_at(count as usize);
                writer.write(own.iter().map(|&view| self.maps.number(view as usize)))?;
                views = others;
            }
        }
        if let Some(depths) = &mut self.depths {
            depths.add(points, self.maps)?;
        }
        self.ply.take(points)
    }

    fn wants_rows(&self) -> Option<Columns> {
        let only_ply = matches!(self.visible, Visible::None) && self.depths.is_none();
        only_ply.then_some(self.ply.columns)
    }

    fn take_rows(&mut self, rows: &[u8]) -> Result<()> {
        self.ply.take_rows(rows)
    }

    fn view_done(&mut self) -> Result<()> {
        match &mut self.depths {
            Some(depths) => depths.write(self.maps),
            None => Ok(()),
        }
    }

    fn wants_visible(&self) -> bool {
        matches!(self.visible, Visible::Writer(_))
    }
}

/// COLMAP's side car, or none.
pub(super) enum Visible {
    /// Not wanted.
    None,
    /// Being written.
    Writer(VisibleWriter),
}

impl Visible {
    pub(super) fn create(path: &Path, force: bool) -> Result<Self> {
        crate::jobs::check_out_file(path, force)?;
        Ok(Self::Writer(VisibleWriter::create(path)?))
    }
}

/// The depths that became points, view by view, as maps. They get to their folder when all are
/// there.
pub(super) struct DepthFolder {
    path: PathBuf,
    /// Where they wait.
    waiting: ScratchFolder,
    names: Vec<String>,
    /// Views whose points have come.
    done: usize,
    /// What has come of the next view.
    map: Option<Raster<f32>>,
}

impl DepthFolder {
    pub(super) fn create(path: &Path, maps: &FolderMaps<'_>, force: bool) -> Result<Self> {
        let file = |index| path.join(mvsnet::file_name(maps.view(index).id, ".pfm"));
        let there = (0..maps.count()).map(file).find(|file| file.exists());
        if let (Some(there), false) = (there, force) {
            return Err(Error::exists(&there));
        }
        if path.exists() && !path.is_dir() {
            let problem = "expected a folder for the filtered depth maps, found a file";
            return Err(Error::invalid(path.display().to_string(), problem));
        }
        if path.is_dir() {
            // Where nothing can be written, that is said before the work.
            ScratchFolder::beside(&path.join("maps"))?;
        }
        Ok(Self {
            path: path.to_path_buf(),
            waiting: ScratchFolder::beside(path)?,
            names: Vec::new(),
            done: 0,
            map: None,
        })
    }

    /// The map of the next view.
    fn map(&mut self, maps: &FolderMaps<'_>) -> Result<Raster<f32>> {
        let camera = &maps.view(self.done).camera;
        match self.map.take() {
            Some(map) => Ok(map),
            None => Ok(Raster::filled(camera.width(), camera.height(), 0.0)?),
        }
    }

    /// Puts the depths of points of the next view at the pixels that they came from, from which `gipuma` moves
    /// them.
    fn add(&mut self, points: &Points, maps: &FolderMaps<'_>) -> Result<()> {
        let mut map = self.map(maps)?;
        let view = maps.view(self.done);
        for (&position, &pixel) in points.positions.iter().zip(&points.pixels) {
            let depth = view.pose.to_cam(position).z;
            let (column, row) = (pixel % map.width(), pixel / map.width());
            #[allow(clippy::cast_possible_truncation, reason = "depths are f32")]
            map.set(column, row, depth as f32);
        }
        self.map = Some(map);
        Ok(())
    }

    /// Moves the maps to their folder.
    pub(super) fn finish(self) -> Result<()> {
        let folder = &self.path;
        std::fs::create_dir_all(folder)
            .map_err(mvs_datasets::Error::io(folder, "create the folder"))?;
        for name in &self.names {
            let path = folder.join(name);
            std::fs::rename(self.waiting.folder().join(name), &path)
                .map_err(mvs_datasets::Error::io(&path, "write"))?;
        }
        Ok(())
    }

    /// Writes the next view's map.
    fn write(&mut self, maps: &FolderMaps<'_>) -> Result<()> {
        let map = self.map(maps)?;
        let name = mvsnet::file_name(maps.view(self.done).id, ".pfm");
        self.done += 1;
        files::write_atomically(&self.waiting.folder().join(&name), |out| {
            pfm::write_gray(out, &map)
        })?;
        self.names.push(name);
        Ok(())
    }
}

/// Writes points as rows of a PLY.
pub(super) struct PlySink<W> {
    writer: StreamWriter<W>,
    columns: Columns,
    /// For errors.
    path: PathBuf,
    /// Room for some rows.
    rows: Vec<u8>,
}

/// How many points become rows at a time.
const ROWS: usize = 1 << 12;

/// The vertex's properties.
fn properties(columns: Columns) -> Vec<(&'static str, Scalar)> {
    let coordinate = match columns.has(Columns::DOUBLES) {
        true => Scalar::Double,
        false => Scalar::Float,
    };
    let mut all = ["x", "y", "z"].map(|name| (name, coordinate)).to_vec();
    if columns.has(Columns::NORMALS) {
        all.extend(["nx", "ny", "nz"].map(|name| (name, Scalar::Float)));
    }
    if columns.has(Columns::COLORS) {
        all.extend(["red", "green", "blue"].map(|name| (name, Scalar::Uchar)));
    }
    // COLMAP reads no integers but of 8 bits.
    let number = match columns.has(Columns::MANY) {
        true => Scalar::Float,
        false => Scalar::Uchar,
    };
    all.push(("views", number));
    if columns.has(Columns::CONFIDENCES) {
        all.push(("confidence", Scalar::Float));
    }
    if columns.has(Columns::EXTRAS) {
        all.extend([("violations", number), ("scale", Scalar::Float)]);
    }
    all
}

impl<W: Write + Seek> PlySink<W> {
    pub(super) fn new(
        out: W,
        columns: Columns,
        comments: &[String],
        path: &Path,
    ) -> std::io::Result<Self> {
        let properties = properties(columns);
        Ok(Self {
            writer: StreamWriter::new(out, &properties, comments)?,
            columns,
            path: path.to_path_buf(),
            rows: Vec::new(),
        })
    }

    pub(super) fn count(&self) -> u64 {
        self.writer.count()
    }

    /// Writes the number of points, and what is left.
    fn complete(&mut self) -> Result<u64> {
        let written = self.writer.complete();
        Ok(written.map_err(mvs_datasets::Error::io(&self.path, "write"))?)
    }
}

impl<W: Write + Seek> PointSink for PlySink<W> {
    fn take(&mut self, points: &Points) -> Result<()> {
        let mut rows = std::mem::take(&mut self.rows);
        for start in (0..points.len()).step_by(ROWS) {
            let range = start..points.len().min(start + ROWS);
            points.to_rows(self.columns, range, &mut rows);
            self.take_rows(&rows)?;
        }
        self.rows = rows;
        Ok(())
    }

    fn wants_rows(&self) -> Option<Columns> {
        Some(self.columns)
    }

    fn take_rows(&mut self, rows: &[u8]) -> Result<()> {
        let written = self.writer.write(rows);
        Ok(written.map_err(mvs_datasets::Error::io(&self.path, "write"))?)
    }
}
