//! Passes over all views. Each reads only what the one before wrote, so that bands of rows are
//! independent, results do not depend on threads, and only the present view and its sources are in
//! memory.

use super::cache::Cache;
use super::cluster::fuse_clusters;
use super::counts::FuseCounts;
use super::geometry::PairGeometry;
use super::inputs::{DepthMaps, Scratch, check_size, check_views};
use super::merrell::render;
use super::options::{Colors, FuseMode, FuseOptions, Visibility};
use super::points::{Columns, PointSink, Points};
use super::reference::{Finish, Reference, Region, Source};
use super::rules::Rule;
use super::samples::{Filters, Samples, Unit, confidence, prepare};
use super::selection::{Confidences, Selection, Witness};
use crate::error::Result;
use crate::parallel;
use crate::progress::Progress;
use crate::warning::Warnings;
use mvs_datasets::scene::{Aabb, ColorImage, Raster};
use std::ops::Range;
use std::sync::Arc;

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
/// No views, options out of range, maps that do not have their camera's size, sources that are no
/// other view, whatever reading and writing brings, and interruption.
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
    let engine = Engine { inputs, options };
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
    let lacking: Vec<u32> = (0..inputs.maps.count())
        .filter(|&index| {
            let used = options.sources_used(inputs.maps.sources(index).len());
            used < options.sources_needed(used)
        })
        .map(|index| inputs.maps.view(index).id)
        .collect();
    if let Some(first) = lacking.first() {
        let message = format!(
            "{} of {} views have fewer source views than must agree and give no points, the first \
             is view {first}: list more sources in pair.txt or lower the minimum",
            lacking.len(),
            inputs.maps.count()
        );
        inputs.warnings.add("few-sources", message);
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
}

impl Engine<'_> {
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
            reference.needed = 1;
            let bands = self.bands(&reference, |rows| reference.new_depths(rows));
            let mut stored = Vec::new();
            for (band, more) in bands {
                stored.extend(band);
                counts = counts.plus(more);
            }
            self.inputs.scratch.store(self.key(to, index), stored)?;
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
                sources: parallel::map(reference.sources.len(), witness),
                options: self.options,
            };
            let mut stored = Vec::new();
            for (band, more) in self.bands(&reference, |rows| selection.select(rows)) {
                stored.extend(band);
                counts = counts.plus(more);
            }
            self.inputs.scratch.store(self.key(to, index), stored)?;
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
        let columns = columns(self.inputs.maps, self.options);
        let mut cache = Cache::new(self.inputs.memory / 2);
        let mut images = Cache::new(self.inputs.memory / 2);
        self.for_each_view("making points", |index| {
            let (mut reference, mut counts) = self.reference(index, from, rule, &mut cache)?;
            let finish = self.finish(&mut reference, columns, &mut images)?;
            let bands = self.bands(&reference, |rows| reference.points(rows, &finish));
            let mut points = Points::default();
            for (band, more) in bands {
                points.append(band);
                counts = counts.plus(more);
            }
            sink.take(points, &counts)?;
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

    /// The view at `index` as a reference, and what the filters left out of it.
    fn reference(
        &self,
        index: usize,
        from: Maps,
        rule: Rule,
        cache: &mut Cache<Samples>,
    ) -> Result<(Reference<'_>, FuseCounts)> {
        let maps = self.inputs.maps;
        let view = maps.view(index);
        let listed = maps.sources(index);
        let used = &listed[..self.options.sources_used(listed.len())];
        let samples = cache.get(used, |source| {
            let samples = self.source_samples(source, from)?;
            let bytes = samples.bytes();
            Ok((samples, bytes))
        })?;
        let (own, counts) = match from {
            Maps::Input(_) => prepare(maps, index, self.options, Filters::All)?,
            Maps::Pass(_) => (self.source_samples(index, from)?, FuseCounts::default()),
        };
        let source = |(&number, samples)| {
            Source::new(view, (number, maps.view(number)), samples, self.options)
        };
        let reference = Reference {
            number: index,
            view,
            samples: Arc::new(own),
            sources: used.iter().zip(samples).map(source).collect(),
            options: self.options,
            rule,
            needed: self.options.sources_needed(used.len()),
        };
        Ok((reference, counts))
    }

    fn source_samples(&self, index: usize, from: Maps) -> Result<Samples> {
        let pass = match from {
            Maps::Input(filters) => {
                return Ok(prepare(self.inputs.maps, index, self.options, filters)?.0);
            }
            Maps::Pass(pass) => pass,
        };
        let camera = &self.inputs.maps.view(index).camera;
        let stored = self.inputs.scratch.fetch(self.key(pass, index))?;
        let size = (camera.width(), camera.height());
        Ok(Samples::new(size, Unit::of(self.options), &stored))
    }

    /// Fetches what finished points need; the sources' images are put into `reference`.
    fn finish(
        &self,
        reference: &mut Reference<'_>,
        columns: Columns,
        images: &mut Cache<ColorImage>,
    ) -> Result<Finish<'_>> {
        let maps = self.inputs.maps;
        let index = reference.number;
        let mut image = None;
        if columns.has(Columns::COLORS) {
            let mut wanted = vec![index];
            if self.options.colors == Colors::Mean {
                wanted.extend(reference.sources.iter().map(|source| source.number));
            }
            let mut found = images.get(&wanted, |at| self.image(at))?.into_iter();
            image = found.next();
            for (source, image) in reference.sources.iter_mut().zip(found) {
                source.image = Some(image);
            }
        }
        let normals = maps
            .normals(index)?
            .filter(|_| columns.has(Columns::NORMALS));
        if let Some(normals) = &normals {
            check_size(reference.view, normals.size(), "normal map")?;
        }
        Ok(Finish {
            columns,
            image,
            confidence: confidence(maps, index)?.filter(|_| columns.has(Columns::CONFIDENCES)),
            normals,
            region: self.inputs.region,
        })
    }

    fn image(&self, index: usize) -> Result<(ColorImage, usize)> {
        let Some(image) = self.inputs.maps.image(index)? else {
            let view = format!("view {}", self.inputs.maps.view(index).id);
            return Err(crate::Error::invalid(view, "expected an image, found none"));
        };
        let bytes = image.values().len() * 3;
        Ok((image, bytes))
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fuse::testing::{Plane, arc, spoil};
    use crate::fuse::{Estimate, MEMORY, MemoryScratch, Sampling, fuse, oracle};
    use crate::progress::Silent;
    use glam::{DVec2, DVec3};
    use mvs_datasets::scene::View;

    fn plane() -> Plane {
        Plane {
            normal: DVec3::new(0.2, -0.3, 1.0).normalize(),
            offset: 0.1,
        }
    }

    fn noisy(views: usize, size: (u32, u32)) -> Vec<Estimate> {
        let surface = |view: &View, pixel| plane().depth(view, pixel);
        let mut estimates = arc(views, size, DVec3::ZERO, surface);
        for (index, estimate) in estimates.iter_mut().enumerate() {
            spoil(estimate, index as u64, 1e-3, 0.03, 12);
        }
        estimates
    }

    fn off(points: &[DVec3]) -> Vec<f64> {
        let error = |p: &DVec3| (plane().normal.dot(*p) - plane().offset).abs();
        let mut errors: Vec<f64> = points.iter().map(error).collect();
        errors.sort_by(f64::total_cmp);
        errors
    }

    #[test]
    fn geo_equals_the_pixel_by_pixel_oracle() {
        let estimates = noisy(6, (160, 120));
        let options = FuseOptions::of(FuseMode::Geo);
        let fused = fuse(&estimates, &options, &Silent).unwrap();
        let mut expected = Vec::new();
        for index in 0..estimates.len() {
            let reference = oracle::Reference::new(&estimates, index, &options);
            expected.extend(reference.fuse_rows(0..120).points);
        }
        // A handful of pixels stands so near to a bound that f32 decides otherwise.
        let (found, wanted) = (fused.cloud.len(), expected.len());
        assert!(
            found.abs_diff(wanted) <= 6 * 160 * 120 / 20_000,
            "{found} {wanted}"
        );
        assert!(wanted > 6 * 160 * 120 / 2);
        let mut cursor = 0;
        let mut unmatched = 0;
        for point in &expected {
            let near = fused.cloud.positions()[cursor..]
                .iter()
                .take(4)
                .position(|p| (*p - point.position).length() < 4e-6);
            match near {
                Some(skipped) => cursor += skipped + 1,
                None => unmatched += 1,
            }
        }
        assert!(unmatched <= 6 * 160 * 120 / 20_000, "{unmatched}");
    }

    #[test]
    fn hkust_is_exact_on_a_noise_free_plane_up_to_the_borders() {
        let surface = |view: &View, pixel| plane().depth(view, pixel);
        let estimates = arc(5, (64, 48), DVec3::ZERO, surface);
        let fused = fuse(&estimates, &FuseOptions::default(), &Silent).unwrap();
        assert!(
            fused.counts.fused > fused.counts.pixels * 3 / 4,
            "{:?}",
            fused.counts
        );
        // Within a pixel of a map's border samples are extrapolated by up to half a pixel.
        let at_border = |view: &View, position: DVec3| {
            let pixel = view.camera.project(view.pose.to_cam(position)).unwrap();
            let margin = pixel.min(DVec2::new(64.0, 48.0) - pixel).min_element();
            margin.abs() < 1.5
        };
        let inside = |position: &&DVec3| !estimates.iter().any(|e| at_border(&e.view, **position));
        let inside: Vec<DVec3> = fused
            .cloud
            .positions()
            .iter()
            .filter(inside)
            .copied()
            .collect();
        assert!(inside.len() > fused.cloud.len() / 2);
        let worst = off(&inside).pop().unwrap();
        assert!(worst < 1e-6 * 3.5, "{worst:e}");
        let turned = |n: &glam::Vec3| (n.as_dvec3() - plane().normal).length();
        let mut turned: Vec<f64> = fused.cloud.normals().unwrap().iter().map(turned).collect();
        turned.sort_by(f64::total_cmp);
        assert!(
            turned[turned.len() / 2] < 1e-4,
            "{:e}",
            turned[turned.len() / 2]
        );
    }

    #[test]
    fn valid_sampling_keeps_what_plain_sampling_loses_at_holes() {
        let estimates = noisy(7, (160, 120));
        let with = |sampling| {
            let options = FuseOptions {
                sampling,
                min_sources: 5,
                soften: false,
                ..FuseOptions::default()
            };
            fuse(&estimates, &options, &Silent).unwrap()
        };
        let (valid, plain) = (with(Sampling::Valid), with(Sampling::Plain));
        let kept = |fused: &crate::fuse::Fused| fused.counts.fused;
        assert!(
            kept(&valid) > kept(&plain) * 6 / 5,
            "{} {}",
            kept(&valid),
            kept(&plain)
        );
        let median = |points: &[DVec3]| off(points)[points.len() / 2];
        let (of_valid, of_plain) = (
            median(valid.cloud.positions()),
            median(plain.cloud.positions()),
        );
        assert!(of_valid < 1.1 * of_plain, "{of_valid:e} {of_plain:e}");
        // Far below the noise of one map: 1e-3 of about 4 units, median of a Gaussian 0.67 of that.
        assert!(of_valid < 0.5 * 0.67 * 4e-3, "{of_valid:e}");
    }

    #[test]
    fn every_pixel_is_accounted_for_in_every_mode() {
        let mut estimates = noisy(5, (64, 48));
        for estimate in &mut estimates {
            let mut confidence = vec![1.0; 64 * 48];
            confidence[..500].fill(0.2);
            estimate.confidence =
                Some(mvs_datasets::scene::Raster::from_values(64, 48, confidence).unwrap());
        }
        for mode in [
            FuseMode::Hkust,
            FuseMode::Geo,
            FuseMode::Dynamic,
            FuseMode::Gipuma,
            FuseMode::Cluster,
        ] {
            let options = FuseOptions {
                bounds: Some([[-0.5; 3], [0.5; 3]]),
                max_depth: 4.4,
                ..FuseOptions::of(mode)
            };
            let counts = fuse(&estimates, &options, &Silent).unwrap().counts;
            assert_eq!(counts.pixels, 5 * 64 * 48, "{mode:?}");
            assert_eq!(counts.accounted(), counts.pixels, "{mode:?} {counts:?}");
            assert!(
                counts.fused > 100 && counts.outside > 0,
                "{mode:?} {counts:?}"
            );
            assert!(
                counts.unconfident > 0 && counts.out_of_range > 0,
                "{mode:?} {counts:?}"
            );
        }
    }

    #[test]
    fn merrells_rules_fill_holes_and_stay_on_the_surface() {
        let estimates = noisy(7, (160, 120));
        let with = |visibility| {
            let options = FuseOptions {
                visibility,
                ..FuseOptions::default()
            };
            fuse(&estimates, &options, &Silent).unwrap()
        };
        let median = with(Visibility::Median);
        let middle = |points: &[DVec3]| off(points)[points.len() / 2];
        for visibility in [Visibility::MerrellConfidence, Visibility::MerrellStability] {
            let fused = with(visibility);
            assert!(
                fused.counts.filled > 300,
                "{visibility:?} {:?}",
                fused.counts
            );
            assert_eq!(
                fused.counts.accounted(),
                fused.counts.pixels,
                "{visibility:?}"
            );
            // The nearest stable depth may be one in front of the surface, which is filtered later.
            let least = match visibility {
                Visibility::MerrellConfidence => median.counts.fused,
                _ => median.counts.fused * 9 / 10,
            };
            assert!(
                fused.counts.fused > least,
                "{visibility:?} {:?}",
                fused.counts
            );
            let (error, bound) = (
                middle(fused.cloud.positions()),
                2.0 * middle(median.cloud.positions()),
            );
            assert!(error < bound, "{visibility:?} {error:e} {bound:e}");
        }
    }

    #[test]
    fn clusters_merge_what_views_share() {
        let surface = |view: &View, pixel| plane().depth(view, pixel);
        let estimates = arc(6, (64, 48), DVec3::ZERO, surface);
        let fused = fuse(&estimates, &FuseOptions::of(FuseMode::Cluster), &Silent).unwrap();
        let counts = fused.counts;
        assert_eq!(counts.accounted(), counts.pixels);
        // Two pixels of tolerance let neighbours join: about 4 × 4 pixels of one view's size become
        // a point, from all six views.
        assert!(
            counts.fused > 500 && counts.merged > 10 * counts.fused,
            "{counts:?}"
        );
        // Medians by component of points up to two pixels of 0.05 units apart.
        let middle = off(fused.cloud.positions())[fused.cloud.len() / 2];
        assert!(middle < 0.1 * 0.05, "{middle:e}");
        assert!(
            fused
                .cloud
                .view_counts()
                .unwrap()
                .iter()
                .all(|&views| views <= 6)
        );
    }

    #[test]
    fn the_same_points_under_any_budget_of_memory_and_number_of_threads() {
        let estimates = noisy(5, (64, 50));
        let with = |memory, threads| {
            let mut points = Points::default();
            let inputs = FuseInputs {
                maps: &estimates.as_slice(),
                region: None,
                scratch: &MemoryScratch::default(),
                memory,
                progress: &Silent,
                warnings: &Warnings::default(),
            };
            let options = FuseOptions::default();
            let counts = parallel::with_threads(threads, || {
                let mut sink = Points::default();
                let counts = fuse_maps(&inputs, &options, &mut sink).unwrap();
                (counts, sink)
            });
            let (counts, found) = counts.unwrap();
            points.append(found);
            (counts, points)
        };
        let reference = with(MEMORY, 1);
        assert!(!reference.1.is_empty());
        assert_eq!(reference, with(MEMORY, 8));
        assert_eq!(reference, with(0, 2));
    }

    #[test]
    fn views_without_enough_sources_are_warned_of() {
        let mut estimates = noisy(4, (32, 24));
        estimates[2].sources.clear();
        let warnings = Warnings::default();
        let inputs = FuseInputs {
            maps: &estimates.as_slice(),
            region: None,
            scratch: &MemoryScratch::default(),
            memory: MEMORY,
            progress: &Silent,
            warnings: &warnings,
        };
        fuse_maps(&inputs, &FuseOptions::default(), &mut Points::default()).unwrap();
        let found = warnings.sorted();
        assert_eq!(found.len(), 1);
        assert!(
            found[0].message.starts_with("1 of 4 views"),
            "{}",
            found[0].message
        );
    }
}
