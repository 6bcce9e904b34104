//! Passes over all views. Each reads only what the one before wrote, so that bands of rows are
//! independent, results do not depend on threads, and only the present view and its sources are in
//! memory.

use super::cache::Cache;
use super::cluster::fuse_clusters;
use super::counts::FuseCounts;
use super::geometry::PairGeometry;
use super::inputs::{DepthMaps, Scratch, check_views};
use super::merrell::render;
use super::options::{Colors, FuseMode, FuseOptions, Visibility};
use super::points::{Columns, PointSink};
use super::reference::{Band, Reference, Region};
use super::rules::Rule;
use super::samples::{Filters, PixelFilter, Samples, Shape, Unit, confidence};
use super::selection::{Confidences, Selection, Witness};
use super::steps::DYNAMIC_FROM;
use crate::error::Result;
use crate::parallel;
use crate::progress::Progress;
use crate::warning::Warnings;
use mvs_datasets::scene::{Aabb, Raster};
use std::collections::BTreeMap;
use std::ops::Range;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Rows that one task works on.
const BAND_ROWS: usize = 16;

/// What fusion is given beside its options. Only `maps` and `region` can change the result.
#[derive(Clone, Copy)]
pub struct FuseInputs<'a> {
    /// The depth maps.
    pub maps: &'a dyn DepthMaps,
    /// Leaves out points of which it says no.
    pub region: Option<&'a Region<'a>>,
    /// Keeps the maps between passes.
    pub scratch: &'a dyn Scratch,
    /// About how many bytes of depth maps and images to hold at a time, beyond the present view and
    /// its sources.
    pub memory: usize,
    /// Hears how far the work is.
    pub progress: &'a dyn Progress,
    /// Collects warnings.
    pub warnings: &'a Warnings,
}

/// Fuses `inputs` view by view; points go to `sink` as they are finished.
///
/// Points come by view and row-major pixel, whatever the number of threads and the memory.
///
/// # Errors
/// No views, options out of range, cameras with a lens, maps that do not have their camera's size, sources that
/// are no other view, whatever reading and writing brings, and interruption.
pub fn fuse_maps(
    inputs: &FuseInputs<'_>,
    options: &FuseOptions,
    sink: &mut dyn PointSink,
) -> Result<FuseCounts> {
    options.check()?;
    check_views(inputs.maps)?;
    warn_of_few_sources(inputs, options);
    let bounds = options.bounds.map(|[min, max]| Aabb {
        min: min.into(),
        max: max.into(),
    });
    let wanted = |point| {
        bounds.is_none_or(|bounds| bounds.contains(point))
            && inputs.region.is_none_or(|region| region(point))
    };
    let region: Option<&Region<'_>> = if bounds.is_some() || inputs.region.is_some() {
        Some(&wanted)
    } else {
        None
    };
    let inputs = &FuseInputs { region, ..*inputs };
    let engine = Engine {
        inputs,
        options,
        shapes: Mutex::default(),
        spare: Mutex::default(),
    };
    match options.mode {
        FuseMode::Hkust => engine.hkust(sink),
        FuseMode::Geo | FuseMode::Dynamic | FuseMode::Gipuma => engine.single(sink),
        FuseMode::Cluster => fuse_clusters(inputs, options, sink),
    }
}

/// The columns that the points of these inputs have.
pub fn columns(maps: &dyn DepthMaps, options: &FuseOptions) -> Columns {
    Columns::NORMALS
        .when(options.normals)
        .and(Columns::COLORS.when(maps.has_images()))
        .and(Columns::CONFIDENCES.when(maps.has_confidence()))
}

fn warn_of_few_sources(inputs: &FuseInputs<'_>, options: &FuseOptions) {
    if options.mode == FuseMode::Cluster {
        return;
    }
    let (mut lacking, mut softened) = (Vec::new(), Vec::new());
    let mut enough_listed = false;
    for index in 0..inputs.maps.count() {
        let listed = inputs.maps.sources(index).len();
        let used = options.sources_used(listed);
        let needed = match options.mode {
            FuseMode::Dynamic => DYNAMIC_FROM,
            _ => options.sources_needed(used),
        };
        let id = inputs.maps.view(index).id;
        if used < needed {
            lacking.push(id);
            enough_listed |= listed >= needed;
        } else if needed < options.min_sources && options.mode != FuseMode::Dynamic {
            softened.push(id);
        }
    }
    let count = inputs.maps.count();
    if let Some(first) = lacking.first() {
        let more = match enough_listed {
            true => "use more of those listed (--max-sources)",
            false => "list more sources in pair.txt",
        };
        let message = format!(
            "{} of {count} views have fewer source views than must agree and give no points, the first \
             is view {first}: {more} or lower the minimum",
            lacking.len(),
        );
        inputs.warnings.add("few-sources", message);
    }
    if let Some(first) = softened.first() {
        let message = format!(
            "{} of {count} views have so few source views that fewer than {} of them must agree, the \
             first is view {first}",
            softened.len(),
            options.min_sources
        );
        inputs.warnings.add("softened-minimum", message);
    }
}

/// Which maps a pass reads.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Maps {
    /// The inputs, references through all filters, sources through these.
    Input(Filters),
    /// What pass number n wrote.
    Pass(u64),
}

struct Engine<'a> {
    inputs: &'a FuseInputs<'a>,
    options: &'a FuseOptions,
    /// By view, where its depths of the pass before are.
    shapes: Mutex<BTreeMap<usize, Arc<Shape>>>,
    /// Room for a view's confidences.
    spare: Mutex<Vec<f32>>,
}

impl Engine<'_> {
    fn spare(&self) -> MutexGuard<'_, Vec<f32>> {
        self.spare.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn shapes(&self) -> MutexGuard<'_, BTreeMap<usize, Arc<Shape>>> {
        self.shapes.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The modes with one pass. Their confidence filter asks the reference only, except `gipuma`'s.
    fn single(&self, sink: &mut dyn PointSink) -> Result<FuseCounts> {
        let filters = match self.options.mode {
            FuseMode::Gipuma => Filters::All,
            _ => Filters::Depth,
        };
        let rule = Rule::of(self.options.mode);
        self.point_pass(Maps::Input(filters), rule, sink)
    }

    /// Visibility fusion, average fusion, visibility filter.
    fn hkust(&self, sink: &mut dyn PointSink) -> Result<FuseCounts> {
        let input = Maps::Input(Filters::All);
        let (mut counts, averaged) = match self.options.visibility {
            Visibility::None => (FuseCounts::default(), input),
            Visibility::MerrellConfidence | Visibility::MerrellStability => {
                (self.selection_pass(0)?, Maps::Pass(0))
            }
            Visibility::Median => (self.depth_pass(input, Rule::Median, 0)?, Maps::Pass(0)),
        };
        counts = counts.plus(self.depth_pass(averaged, Rule::Average, 1)?);
        self.discard(averaged)?;
        counts = counts.plus(self.point_pass(Maps::Pass(1), Rule::Keep, sink)?);
        self.discard(Maps::Pass(1))?;
        Ok(counts)
    }

    /// Writes new depths for every view under pass number `to`.
    fn depth_pass(&self, from: Maps, rule: Rule, to: u64) -> Result<FuseCounts> {
        let stage = match rule {
            Rule::Median => "fusing by visibility",
            _ => "averaging",
        };
        let mut cache = Cache::new(self.inputs.memory);
        self.for_each_view(stage, |index| {
            let (mut reference, mut counts) = self.reference(index, from, rule, &mut cache)?;
            (reference.needed, reference.soften) = (self.options.min_sources.min(1), false);
            let stride = reference.samples.stride();
            let mut stored = reference.samples.shape().zeros();
            let inner = stride..stored.len() - stride;
            let bands = stored[inner].chunks_mut(BAND_ROWS * stride);
            let mut bands: Vec<_> = bands.map(|band| (band, FuseCounts::default())).collect();
            parallel::for_each_chunk(&mut bands, 1, |at, band| {
                for (stored, counts) in band {
                    let first = at * BAND_ROWS;
                    *counts = reference.new_depths(first..first + stored.len() / stride, stored);
                }
            });
            for (_, more) in bands {
                counts = counts.plus(more);
            }
            self.inputs.scratch.store(self.key(to, index), stored)?;
            // A pass leaves out pixels and finds none.
            let shape = Arc::clone(reference.samples.shape());
            self.shapes().insert(index, shape);
            Ok(counts)
        })
    }

    /// Writes the depths that Merrell's rules select for every view under pass number `to`.
    fn selection_pass(&self, to: u64) -> Result<FuseCounts> {
        let input = Maps::Input(Filters::All);
        let mut cache = Cache::new(self.inputs.memory / 2);
        let mut confidences = Cache::new(self.inputs.memory / 2);
        self.for_each_view("fusing by visibility", |index| {
            let (reference, mut counts) = self.reference(index, input, Rule::Keep, &mut cache)?;
            let mut wanted = vec![index];
            wanted.extend(reference.sources.iter().map(|source| source.number));
            let known = confidences.get(&wanted, |at| self.confidences(at))?;
            let witness = |at: usize| self.witness(&reference, at, &known);
            let selection = Selection {
                own: &reference.samples,
                own_confidences: Arc::clone(&known[0]),
                filter: PixelFilter::read(self.inputs.maps, index, self.options)?,
                sources: parallel::map(reference.sources.len(), witness),
                options: self.options,
            };
            let mut stored = Vec::new();
            for (band, more) in self.bands(&reference, |rows| selection.select(rows)) {
                stored.extend(band);
                counts = counts.plus(more);
            }
            let camera = &reference.view.camera;
            let (size, unit) = ((camera.width(), camera.height()), Unit::of(self.options));
            let values = Samples::new(size, unit, &stored).into_values();
            self.inputs.scratch.store(self.key(to, index), values)?;
            Ok(counts)
        })
    }

    fn witness(
        &self,
        reference: &Reference<'_>,
        at: usize,
        confidences: &[Arc<Confidences>],
    ) -> Witness {
        let source = &reference.sources[at];
        let view = self.inputs.maps.view(source.number);
        Witness {
            pair: PairGeometry::new(reference.view, view),
            samples: Arc::clone(&source.samples),
            confidences: Arc::clone(&confidences[at + 1]),
            rendered: render(reference.view, view, &source.samples),
        }
    }

    fn confidences(&self, index: usize) -> Result<(Confidences, usize)> {
        let values =
            confidence(self.inputs.maps, index)?.map_or_else(Vec::new, Raster::into_values);
        let bytes = values.len() * size_of::<f32>();
        Ok((values, bytes))
    }

    /// Sends the points of every view to `sink`.
    fn point_pass(&self, from: Maps, rule: Rule, sink: &mut dyn PointSink) -> Result<FuseCounts> {
        let columns = columns(self.inputs.maps, self.options)
            .and(Columns::VISIBLE.when(sink.wants_visible()));
        let as_bytes = sink.wants_rows();
        let mut cache = Cache::new(self.inputs.memory / 2);
        // Of the reference alone they are wanted once.
        let mut images = Cache::new(match self.options.colors {
            Colors::Mean => self.inputs.memory / 2,
            Colors::Reference => 0,
        });
        // Bands of rows worked on at a time; their memory is used again.
        // One thread takes points from the cache, where they were just put; others wait for none.
        let at_a_time = match parallel::threads() {
            1 => 1,
            threads => 4 * threads,
        };
        let mut bands: Vec<Band> = (0..at_a_time).map(|_| Band::default()).collect();
        self.for_each_view("making points", |index| {
            let (mut reference, mut counts) = self.reference(index, from, rule, &mut cache)?;
            let mut finish = self.finish(&mut reference, columns, &mut images)?;
            finish.as_bytes = as_bytes;
            let height = reference.samples.height();
            let batch_rows = bands.len() * BAND_ROWS;
            for first in (0..height).step_by(batch_rows) {
                parallel::for_each_chunk(&mut bands, 1, |at, band| {
                    let start = (first + at * BAND_ROWS).min(height);
                    let rows = start..(start + BAND_ROWS).min(height);
                    for band in band {
                        reference.points(rows.clone(), &finish, band);
                    }
                });
                for band in &bands {
                    match as_bytes {
                        Some(_) => band.bytes.rows().try_for_each(|row| sink.take_rows(row)),
                        None => band.rows.iter().try_for_each(|row| sink.take(row)),
                    }?;
                    counts = counts.plus(band.counts);
                }
            }
            sink.view_done()?;
            if let Some(confident) = reference.confident.take() {
                *self.spare() = confident.confidences;
            }
            Ok(counts)
        })
    }

    fn for_each_view(
        &self,
        stage: &str,
        mut work: impl FnMut(usize) -> Result<FuseCounts>,
    ) -> Result<FuseCounts> {
        let count = self.inputs.maps.count();
        self.inputs.progress.begin(stage, count as u64);
        let mut counts = FuseCounts::default();
        for index in 0..count {
            self.inputs.progress.check()?;
            counts = counts.plus(work(index)?);
            self.inputs.progress.advance(1);
        }
        Ok(counts)
    }

    fn bands<T: Send>(
        &self,
        reference: &Reference<'_>,
        work: impl Fn(Range<usize>) -> T + Sync + Send,
    ) -> Vec<T> {
        let height = reference.samples.height();
        parallel::map(height.div_ceil(BAND_ROWS), |band| {
            let first = band * BAND_ROWS;
            work(first..(first + BAND_ROWS).min(height))
        })
    }

    fn discard(&self, maps: Maps) -> Result<()> {
        let Maps::Pass(pass) = maps else {
            return Ok(());
        };
        (0..self.inputs.maps.count())
            .try_for_each(|index| self.inputs.scratch.discard(self.key(pass, index)))
    }

    fn key(&self, pass: u64, index: usize) -> u64 {
        pass * self.inputs.maps.count() as u64 + index as u64
    }
}

mod fetch;
#[cfg(test)]
mod tests;
