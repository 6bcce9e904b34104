//! One reference view against its sources: bands of rows to points, or to the depths of the next
//! pass.

use super::counts::FuseCounts;
use super::finish::{Add, Face, Frame, Gather, Locate, Mean, Place, Room};
use super::kernel::{BLOCK, Block, Pair, Seen};
use super::normals;
use super::options::{Colors, FuseOptions};
use super::points::{Columns, Points};
use super::rules::{Against, Bounds, Case, Consensus, Court, Rule, Verdict, disparity_scale};
use super::samples::Samples;
use super::sampling;
use glam::{DVec2, DVec3, Vec3};
use mvs_datasets::scene::{ColorImage, NormalMap, Raster, View};
use pulp::Arch;
use std::ops::Range;
use std::sync::Arc;

/// Columns of a strip.
const STRIP: usize = 16;

/// Tells whether a world point is wanted.
pub type Region<'a> = dyn Fn(DVec3) -> bool + Sync + 'a;

/// A source view, ready to be looked at from the reference.
pub(super) struct Source {
    /// The view's number.
    pub(super) number: usize,
    pub(super) pair: Pair,
    pub(super) samples: Arc<Samples>,
    pub(super) image: Option<SourceImage>,
    /// Centre in the world.
    pub(super) center: DVec3,
    /// See [`disparity_scale`].
    pub(super) disparity: f32,
}

/// A source's photograph and its pixels per pixel of the depth map.
pub(super) struct SourceImage {
    image: Arc<ColorImage>,
    scale: [f32; 2],
}

impl SourceImage {
    #[allow(clippy::cast_precision_loss, reason = "image sizes are far below 2^23")]
    pub(super) fn new(image: Arc<ColorImage>, samples: &Samples) -> Self {
        let scale = [
            image.width() as f32 / samples.width() as f32,
            image.height() as f32 / samples.height() as f32,
        ];
        Self { image, scale }
    }
}

impl Source {
    pub(super) fn new(
        reference: &View,
        (number, view): (usize, &View),
        samples: Arc<Samples>,
        options: &FuseOptions,
    ) -> Self {
        Self {
            number,
            pair: Pair::new(reference, view),
            samples,
            image: None,
            center: view.pose.center_in_world(),
            disparity: disparity_scale(reference, view, options),
        }
    }
}

/// A reference view with all that its pixels are tested against.
pub(super) struct Reference<'a> {
    /// The view's number.
    pub(super) number: usize,
    pub(super) view: &'a View,
    pub(super) samples: Arc<Samples>,
    /// The view's confidence where it was asked for already.
    pub(super) confidence: Option<Raster<f32>>,
    pub(super) sources: Vec<Source>,
    pub(super) options: &'a FuseOptions,
    pub(super) rule: Rule,
    /// Sources that must agree.
    pub(super) needed: usize,
    /// Whether fewer do where nobody else can judge.
    pub(super) soften: bool,
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
        self.for_each_block(rows, STRIP, |block, _, consensus| {
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

    /// Puts the points of `rows` into `points`; what became of the pixels that had a depth.
    pub(super) fn points(
        &self,
        rows: Range<usize>,
        finish: &Finish<'_>,
        points: &mut Points,
    ) -> FuseCounts {
        points.clear();
        let mut counts = FuseCounts::default();
        let mut kept = Vec::with_capacity(BLOCK);
        let mut room = Room::new(self.sources.len());
        let width = self.samples.width();
        self.for_each_block(rows, width, |block, seen, consensus| {
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
            if !kept.is_empty() {
                self.describe(&kept, (block, seen, consensus), finish, (&mut room, points));
            }
        });
        counts
    }

    /// Calls `f` with every block of pixels that have a depth, and what the sources say. Blocks are
    /// taken from the rows of one strip of columns after the other.
    fn for_each_block(
        &self,
        rows: Range<usize>,
        strip: usize,
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
        for left in (0..width).step_by(strip) {
            let right = (left + strip).min(width);
            for row in rows.clone() {
                for (at, values) in self.samples.row(row)[left..right].chunks(STRIP).enumerate() {
                    // Values are ≥ 0: no bit is set where there is no depth.
                    if values.iter().fold(0, |bits, value| bits | value.to_bits()) == 0 {
                        continue;
                    }
                    for (column, &stored) in (left + at * STRIP..).zip(values) {
                        if stored > 0.0 {
                            #[allow(
                                clippy::cast_possible_truncation,
                                reason = "image sizes are u32"
                            )]
                            block.push(width as u32, column as u32, row as u32, stored);
                            if block.is_full() {
                                finish(&mut block);
                            }
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

    /// Adds the `kept` entries as points.
    fn describe(
        &self,
        kept: &[usize],
        (block, seen, consensus): (&Block, &[Seen], &Consensus),
        finish: &Finish<'_>,
        (room, points): (&mut Room, &mut Points),
    ) {
        let kept_ones = kept.iter().copied();
        points
            .positions
            .extend(kept_ones.clone().map(|i| room.position(i)));
        let views = kept_ones.clone().map(|i| consensus.count[i] + 1);
        points.view_counts.extend(views);
        let violations = kept_ones.clone().map(|i| consensus.violations[i]);
        points.violations.extend(violations);
        let focal = 0.5 * (self.view.camera.focal().x + self.view.camera.focal().y);
        #[allow(clippy::cast_possible_truncation, reason = "a size for display")]
        let scale = |i: usize| {
            let fused = f64::from(block.depth[i]) + f64::from(consensus.delta[i]);
            (fused / focal) as f32
        };
        points.scales.extend(kept_ones.clone().map(scale));
        if finish.columns.has(Columns::VISIBLE) {
            for &i in kept {
                points.visible_in.push(number(self.number));
                let pairs = self.sources.iter().zip(seen);
                let agreeing = pairs.filter(|(_, seen)| seen.agrees[i] == 1);
                let numbers = agreeing.map(|(source, _)| number(source.number));
                points.visible_in.extend(numbers);
            }
        }
        if finish.columns.has(Columns::NORMALS) {
            self.add_normals(kept, block, finish, (room, &mut points.normals));
        }
        if finish.columns.has(Columns::COLORS) {
            self.add_colors(kept, (block, seen), finish, (room, &mut points.colors));
        }
        if finish.columns.has(Columns::CONFIDENCES) {
            let confidence = finish.confidence.as_ref();
            let of = |i: usize| confidence.map_or(1.0, |map| map.values()[block.pixel[i] as usize]);
            points.confidences.extend(kept_ones.map(of));
        }
    }

    /// The given normals or the fitted ones, in the world; zero where there is none.
    fn add_normals(
        &self,
        kept: &[usize],
        block: &Block,
        finish: &Finish<'_>,
        (room, normals): (&mut Room, &mut Vec<Vec3>),
    ) {
        let to_world = |in_cam: Vec3| {
            let normal = self.view.pose.direction_to_world(in_cam.as_dvec3());
            normal.as_vec3()
        };
        if let Some(map) = &finish.normals {
            let given = |&i: &usize| to_world(Vec3::from(map.values()[block.pixel[i] as usize]));
            return normals.extend(kept.iter().map(given));
        }
        room.copy_windows(kept, block, &self.samples);
        Arch::new().dispatch(Face {
            frame: &finish.frame,
            block,
            unit: self.samples.unit(),
            similar: self.options.similar_depth,
            room,
        });
        let fitted = |&i: &usize| {
            room.normal(i).unwrap_or_else(|| {
                let at = block.pixel[i] as usize;
                let pixel = (at % self.samples.width(), at / self.samples.width());
                let (camera, similar) = (&self.view.camera, self.options.similar_depth);
                let gappy = normals::from_depth(&self.samples, camera, pixel, similar);
                gappy.map_or(Vec3::ZERO, to_world)
            })
        };
        normals.extend(kept.iter().map(fitted));
    }

    /// The colours of the reference's image, or the means over all images that agree: the
    /// reference's bilinear, a source's at its nearest pixel. White without an image.
    fn add_colors(
        &self,
        kept: &[usize],
        (block, seen): (&Block, &[Seen]),
        finish: &Finish<'_>,
        (room, colors): (&mut Room, &mut Vec<[u8; 3]>),
    ) {
        let Some(image) = &finish.image else {
            return colors.extend(kept.iter().map(|_| [255; 3]));
        };
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
        colors.extend(kept.iter().map(|&i| room.color(i)));
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
