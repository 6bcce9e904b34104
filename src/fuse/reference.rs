//! One reference view against its sources: bands of rows to points, or to the depths of the next
//! pass.

use super::confident::{Confident, Rows};
use super::consensus::Consensus;
use super::counts::FuseCounts;
use super::finish::{Add, Face, Frame, Gather, Locate, Mean, Place, Room};
use super::kernel::{BLOCK, Block, Seen};
use super::normals;
use super::options::{Colors, FuseOptions};
use super::points::{Columns, Points};
use super::rules::{Against, Bounds, Case, Court, Rule, Verdict};
use super::samples::Samples;
use super::sampling;
use super::source::{Source, SourceImage};
use glam::{DVec2, DVec3, Vec3};
use mvs_datasets::scene::{ColorImage, NormalMap, Raster, View};
use pulp::Arch;
use std::ops::Range;
use std::sync::Arc;

/// Columns of a strip.
const STRIP: usize = 16;

/// Tells whether a world point is wanted.
pub type Region<'a> = dyn Fn(DVec3) -> bool + Sync + 'a;

/// A reference view with all that its pixels are tested against.
pub(super) struct Reference<'a> {
    /// The view's number.
    pub(super) number: usize,
    pub(super) view: &'a View,
    pub(super) samples: Arc<Samples>,
    /// Which of its pixels count, where that is not decided yet.
    pub(super) confident: Option<Confident>,
    pub(super) sources: Vec<Source>,
    pub(super) options: &'a FuseOptions,
    pub(super) rule: Rule,
    /// Sources that must agree.
    pub(super) needed: usize,
    /// Whether fewer do where nobody else can judge.
    pub(super) soften: bool,
}

/// What a band of rows becomes; its memory is used again.
#[derive(Default)]
pub(super) struct Band {
    /// The points of each row.
    pub(super) rows: Vec<Points>,
    /// What became of the pixels.
    pub(super) counts: FuseCounts,
    /// Room for the band's own depths.
    room: Vec<f32>,
}

/// What only finished points need.
pub(super) struct Finish<'a> {
    pub(super) frame: Frame,
    /// The sources' centres in the world.
    pub(super) centers: Vec<DVec3>,
    pub(super) columns: Columns,
    pub(super) image: Option<Arc<ColorImage>>,
    pub(super) confidence: Option<Raster<f32>>,
    pub(super) normals: Option<NormalMap>,
    pub(super) region: Option<&'a Region<'a>>,
}

impl Reference<'_> {
    /// Puts the depths of the next pass for `rows` into `stored`, those rows of a bordered map of
    /// zeros. Pixels on which too few sources agree are left out and counted.
    pub(super) fn new_depths(&self, rows: Range<usize>, stored: &mut [f32]) -> FuseCounts {
        let first = (rows.start + 1) * self.samples.stride();
        let mut counts = FuseCounts::default();
        let unit = self.samples.unit();
        self.for_each_block(rows, Rows::all(&self.samples), |block, _, consensus| {
            let mut fused = [0.0; BLOCK];
            let depths = block.depth.iter().zip(&consensus.delta);
            for (fused, (depth, delta)) in fused.iter_mut().zip(depths) {
                *fused = unit.convert(depth + delta);
            }
            for i in 0..block.len {
                if consensus.enough[i] {
                    stored[block.place[i] as usize - first] = fused[i];
                } else {
                    counts.inconsistent += 1;
                }
            }
        });
        counts
    }

    /// Puts the points of `rows` into `band`, and what became of the pixels that had a depth.
    pub(super) fn points(&self, rows: Range<usize>, finish: &Finish<'_>, band: &mut Band) {
        band.rows.resize_with(rows.len(), Points::default);
        band.rows.iter_mut().for_each(Points::clear);
        if rows.is_empty() {
            band.counts = FuseCounts::default();
            return;
        }
        let mut counts = FuseCounts::default();
        let mut kept = Vec::with_capacity(BLOCK);
        let mut room = Room::new(self.sources.len());
        let own = match &self.confident {
            Some(confident) => {
                let (own, unconfident) =
                    confident.band(&self.samples, rows.clone(), &mut band.room);
                counts.unconfident = unconfident;
                own
            }
            None => Rows::all(&self.samples),
        };
        self.for_each_block(rows.clone(), own, |block, seen, consensus| {
            self.place((block, seen, consensus), finish, &mut room);
            kept.clear();
            for i in 0..block.len {
                let wanted = |wanted: &Region<'_>| wanted(room.position(i));
                let fate = if !consensus.enough[i] {
                    &mut counts.inconsistent
                } else if self.options.guard && consensus.violations[i] > consensus.count[i] {
                    &mut counts.contradicted
                } else if finish.region.is_none_or(wanted) {
                    kept.push(i);
                    &mut counts.fused
                } else {
                    &mut counts.outside
                };
                *fate += 1;
            }
            if kept.is_empty() {
                return;
            }
            self.describe(&kept, (block, seen), (finish, own), &mut room);
            let row = |i: usize| block.row(i);
            for run in kept.chunk_by(|&a, &b| row(a) == row(b)) {
                let points = &mut band.rows[row(run[0]) - rows.start];
                self.add(run, (block, seen, consensus), (finish, &room), points);
            }
        });
        band.counts = counts;
    }

    /// Calls `f` with every block of pixels that have a depth, and what the sources say. Blocks are
    /// taken from the rows of one strip of columns after the other.
    fn for_each_block(
        &self,
        rows: Range<usize>,
        own: Rows<'_>,
        mut f: impl FnMut(&Block, &[Seen], &Consensus),
    ) {
        fn against(source: &Source) -> Against<'_> {
            Against {
                pair: &source.pair,
                samples: &source.samples,
                disparity: source.disparity,
            }
        }
        let sources: Vec<Against<'_>> = self.sources.iter().map(against).collect();
        let court = Court {
            rule: self.rule,
            taps: self.rule.taps(self.options),
            bounds: Bounds::new(self.view, self.options),
            needed: u32::try_from(self.needed).unwrap_or(u32::MAX),
            soften: self.soften,
            sources: &sources,
        };
        let mut verdict = Verdict::new(sources.len());
        let arch = Arch::new();
        let mut finish = |block: &mut Block| {
            for depth in &mut block.depth {
                *depth = self.samples.unit().convert(*depth);
            }
            arch.dispatch(Case {
                court,
                block,
                verdict: &mut verdict,
            });
            f(block, &verdict.seen, &verdict.consensus);
            block.len = 0;
        };
        let mut block = Block::new();
        let width = self.samples.width();
        let extents = || rows.clone().map(|row| self.samples.extent(row));
        let filled = || extents().filter(|extent| !extent.is_empty());
        let first = filled().map(|extent| extent.start).min().unwrap_or(0);
        let end = filled().map(|extent| extent.end).max().unwrap_or(0);
        for left in (first / STRIP * STRIP..end).step_by(STRIP) {
            let right = (left + STRIP).min(width);
            for row in rows.clone() {
                let values = &own.row(row)[left..right];
                // Values are ≥ 0: no bit is set where there is no depth.
                if values.iter().fold(0, |bits, value| bits | value.to_bits()) == 0 {
                    continue;
                }
                for (column, &stored) in (left..).zip(values) {
                    if stored > 0.0 {
                        #[allow(clippy::cast_possible_truncation, reason = "image sizes are u32")]
                        block.push(width as u32, column as u32, row as u32, stored);
                        if block.is_full() {
                            finish(&mut block);
                        }
                    }
                }
            }
        }
        if block.len > 0 {
            finish(&mut block);
        }
    }

    /// Computes the block's positions.
    fn place(
        &self,
        (block, seen, consensus): (&Block, &[Seen], &Consensus),
        finish: &Finish<'_>,
        room: &mut Room,
    ) {
        let arch = Arch::new();
        arch.dispatch(Place {
            frame: &finish.frame,
            block,
            consensus,
            room,
        });
        if self.rule == Rule::Disparity {
            arch.dispatch(Gather {
                centers: &finish.centers,
                seen,
                consensus,
                room,
            });
        }
    }

    /// Finds normals and colours of the `kept` entries.
    fn describe(
        &self,
        kept: &[usize],
        (block, seen): (&Block, &[Seen]),
        (finish, own): (&Finish<'_>, Rows<'_>),
        room: &mut Room,
    ) {
        if finish.columns.has(Columns::NORMALS) && finish.normals.is_none() {
            room.copy_windows(kept, block, own);
            Arch::new().dispatch(Face {
                frame: &finish.frame,
                block,
                unit: self.samples.unit(),
                similar: self.options.similar_depth,
                room,
            });
        }
        if let (true, Some(image)) = (finish.columns.has(Columns::COLORS), &finish.image) {
            self.mix_colors(kept, (block, seen), image, room);
        }
    }

    /// Adds a `run` of entries of one row, which are described, as points.
    fn add(
        &self,
        run: &[usize],
        (block, seen, consensus): (&Block, &[Seen], &Consensus),
        (finish, room): (&Finish<'_>, &Room),
        points: &mut Points,
    ) {
        let run_of = || run.iter().copied();
        points.positions.extend(run_of().map(|i| room.position(i)));
        let views = run_of().map(|i| consensus.count[i] + 1);
        points.view_counts.extend(views);
        let violations = run_of().map(|i| consensus.violations[i]);
        points.violations.extend(violations);
        let focal = 0.5 * (self.view.camera.focal().x + self.view.camera.focal().y);
        #[allow(clippy::cast_possible_truncation, reason = "a size for display")]
        let scale = |i: usize| {
            let fused = f64::from(block.depth[i]) + f64::from(consensus.delta[i]);
            (fused / focal) as f32
        };
        points.scales.extend(run_of().map(scale));
        if finish.columns.has(Columns::VISIBLE) {
            for i in run_of() {
                points.visible_in.push(number(self.number));
                let pairs = self.sources.iter().zip(seen);
                let agreeing = pairs.filter(|(_, seen)| seen.agrees[i] == 1);
                let numbers = agreeing.map(|(source, _)| number(source.number));
                points.visible_in.extend(numbers);
            }
        }
        if finish.columns.has(Columns::NORMALS) {
            let normal = |i: usize| self.normal(i, block, finish, room);
            points.normals.extend(run_of().map(normal));
        }
        if finish.columns.has(Columns::COLORS) {
            // White without an image.
            let color = |i: usize| finish.image.as_ref().map_or([255; 3], |_| room.color(i));
            points.colors.extend(run_of().map(color));
        }
        if finish.columns.has(Columns::CONFIDENCES) {
            let own = self
                .confident
                .as_ref()
                .map(|own| own.confidences.as_slice());
            let confidence = own.or(finish.confidence.as_ref().map(Raster::values));
            let of = |i: usize| confidence.map_or(1.0, |map| map[block.pixel[i] as usize]);
            points.confidences.extend(run_of().map(of));
        }
    }

    /// The given normal or the fitted one, in the world; zero where there is none.
    fn normal(&self, i: usize, block: &Block, finish: &Finish<'_>, room: &Room) -> Vec3 {
        let to_world = |in_cam: Vec3| {
            let normal = self.view.pose.direction_to_world(in_cam.as_dvec3());
            normal.as_vec3()
        };
        let at = block.pixel[i] as usize;
        if let Some(map) = &finish.normals {
            return to_world(Vec3::from(map.values()[at]));
        }
        room.normal(i).unwrap_or_else(|| {
            let pixel = (at % self.samples.width(), at / self.samples.width());
            let window = (&room.window(i), self.samples.unit());
            let (camera, similar) = (&self.view.camera, self.options.similar_depth);
            let gappy = normals::from_window(window, camera, pixel, similar);
            gappy.map_or(Vec3::ZERO, to_world)
        })
    }

    /// Mixes the colours of the reference's image, or the means over all images that agree: the
    /// reference's bilinear, a source's at its nearest pixel.
    fn mix_colors(
        &self,
        kept: &[usize],
        (block, seen): (&Block, &[Seen]),
        image: &ColorImage,
        room: &mut Room,
    ) {
        if image.size() == (self.view.camera.width(), self.view.camera.height()) {
            room.own_colors(kept, |i| image.values()[block.pixel[i] as usize]);
        } else {
            let scale = self.scale(image);
            let center = |i: usize| DVec2::new(f64::from(block.u[i]), f64::from(block.v[i]));
            room.own_colors(kept, |i| sampling::color(image, center(i) * scale));
        }
        let arch = Arch::new();
        // Source by source, so that the fetches from its image do not wait for each other.
        let all = self.options.colors == Colors::Mean;
        let images = || {
            let images = self.sources.iter().map(|source| source.image.as_ref());
            let asked = images.zip(seen).enumerate().filter(|_| all);
            asked.filter_map(|(at, (image, seen))| Some((at, image?, seen)))
        };
        for (at, SourceImage { image, scale }, seen) in images() {
            arch.dispatch(Locate {
                seen,
                scale: *scale,
                size: image.size(),
                to: (at, room),
            });
            room.ask(at, kept, image);
        }
        for (at, SourceImage { image, .. }, seen) in images() {
            room.fetch(at, kept, image);
            arch.dispatch(Add {
                agrees: &seen.agrees,
                to: (at, room),
            });
        }
        arch.dispatch(Mean(room));
    }

    /// Image pixels per depth pixel.
    fn scale(&self, image: &ColorImage) -> DVec2 {
        DVec2::new(
            f64::from(image.width()) / f64::from(self.view.camera.width()),
            f64::from(image.height()) / f64::from(self.view.camera.height()),
        )
    }
}

fn number(index: usize) -> u32 {
    u32::try_from(index).unwrap_or(u32::MAX)
}
