//! One reference view against its sources: bands of rows to points, or to the depths of the next
//! pass.

use super::counts::FuseCounts;
use super::kernel::{BLOCK, Block, Pair, Seen};
use super::normals;
use super::options::{Colors, FuseOptions};
use super::points::{Columns, Points};
use super::rules::{
    Against, Bounds, Case, Consensus, Court, Rule, Verdict, disparity_scale, mean_displacement,
};
use super::samples::Samples;
use super::sampling;
use glam::{DVec2, DVec3, Vec3};
use mvs_datasets::scene::{ColorImage, NormalMap, Raster, View};
use pulp::Arch;
use std::ops::Range;
use std::sync::Arc;

/// Tells whether a world point is wanted.
pub type Region<'a> = dyn Fn(DVec3) -> bool + Sync + 'a;

/// A source view, ready to be looked at from the reference.
pub(super) struct Source {
    /// The view's number.
    pub(super) number: usize,
    pub(super) pair: Pair,
    pub(super) samples: Arc<Samples>,
    pub(super) image: Option<SourceImage>,
    /// Centre in the reference's camera frame.
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

    /// The pixel at (`x`, `y`) as [`Seen`] has them, clamped to the image.
    #[allow(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "positions on an image; `as` saturates"
    )]
    fn nearest(&self, x: f32, y: f32) -> [u8; 3] {
        let along = |at: f32, scale: f32, size: u32| (((at - 0.5) * scale) as u32).min(size - 1);
        let column = along(x, self.scale[0], self.image.width());
        let row = along(y, self.scale[1], self.image.height());
        self.image.get(column, row)
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
            center: reference.pose.to_cam(view.pose.center_in_world()),
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
    pub(super) sources: Vec<Source>,
    pub(super) options: &'a FuseOptions,
    pub(super) rule: Rule,
    /// Sources that must agree.
    pub(super) needed: usize,
}

/// What only finished points need.
pub(super) struct Finish<'a> {
    pub(super) columns: Columns,
    pub(super) image: Option<Arc<ColorImage>>,
    pub(super) confidence: Option<Raster<f32>>,
    pub(super) normals: Option<NormalMap>,
    pub(super) region: Option<&'a Region<'a>>,
}

impl Reference<'_> {
    /// The depths of the next pass for `rows`, as stored values row-major. Pixels on which too few
    /// sources agree are left out and counted.
    pub(super) fn new_depths(&self, rows: Range<usize>) -> (Vec<f32>, FuseCounts) {
        let width = self.samples.width();
        let first = rows.start * width;
        let mut stored = vec![0.0; rows.len() * width];
        let mut counts = FuseCounts::default();
        let unit = self.samples.unit();
        self.for_each_block(rows, |block, _, consensus| {
            for i in 0..block.len {
                if consensus.enough[i] {
                    let depth = block.depth[i] + consensus.delta[i];
                    stored[block.pixel[i] as usize - first] = unit.convert(depth);
                } else {
                    counts.inconsistent += 1;
                }
            }
        });
        (stored, counts)
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
        self.for_each_block(rows, |block, seen, consensus| {
            kept.clear();
            for i in 0..block.len {
                let fate = if !consensus.enough[i] {
                    &mut counts.inconsistent
                } else if self.options.guard && consensus.violations[i] > consensus.count[i] {
                    &mut counts.contradicted
                } else if let Some(position) = self.position(i, (block, seen, consensus), finish) {
                    points.positions.push(position);
                    kept.push(i);
                    &mut counts.fused
                } else {
                    &mut counts.outside
                };
                *fate += 1;
            }
            self.describe(&kept, (block, seen, consensus), finish, points);
        });
        counts
    }

    /// Calls `f` with every block of pixels that have a depth, and what the sources say.
    fn for_each_block(&self, rows: Range<usize>, mut f: impl FnMut(&Block, &[Seen], &Consensus)) {
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
            sources: &sources,
        };
        let mut verdict = Verdict::new(sources.len());
        let arch = Arch::new();
        let mut finish = |block: &mut Block| {
            arch.dispatch(Case {
                court,
                block,
                verdict: &mut verdict,
            });
            f(block, &verdict.seen, &verdict.consensus);
            block.len = 0;
        };
        let mut block = Block::new();
        let unit = self.samples.unit();
        for row in rows {
            for (column, &stored) in self.samples.row(row).iter().enumerate() {
                if stored <= 0.0 {
                    continue;
                }
                let pixel = row * self.samples.width() + column;
                #[allow(clippy::cast_possible_truncation, reason = "image sizes are u32")]
                block.push(
                    pixel as u32,
                    column as u32,
                    row as u32,
                    unit.convert(stored),
                );
                if block.is_full() {
                    finish(&mut block);
                }
            }
        }
        if block.len > 0 {
            finish(&mut block);
        }
    }

    /// The point of entry `i`; `None` where it lies outside of the region.
    fn position(
        &self,
        i: usize,
        (block, seen, consensus): (&Block, &[Seen], &Consensus),
        finish: &Finish<'_>,
    ) -> Option<DVec3> {
        let mut in_cam = self.view.camera.ray(center(block, i)) * fused(block, consensus, i);
        if self.rule == Rule::Disparity {
            in_cam += self.displacement(i, in_cam, seen);
        }
        let position = self.view.pose.to_world(in_cam);
        let wanted = finish.region.is_none_or(|wanted| wanted(position));
        wanted.then_some(position)
    }

    /// Adds the other columns of the `kept` entries.
    fn describe(
        &self,
        kept: &[usize],
        (block, seen, consensus): (&Block, &[Seen], &Consensus),
        finish: &Finish<'_>,
        points: &mut Points,
    ) {
        let focal = 0.5 * (self.view.camera.focal().x + self.view.camera.focal().y);
        for &i in kept {
            points.view_counts.push(consensus.count[i] + 1);
            points.violations.push(consensus.violations[i]);
            #[allow(clippy::cast_possible_truncation, reason = "a size for display")]
            points
                .scales
                .push((fused(block, consensus, i) / focal) as f32);
            points.visible_in.push(number(self.number));
            let agreeing = self.agreeing(i, seen);
            points
                .visible_in
                .extend(agreeing.map(|(source, _)| number(source.number)));
        }
        let pixels = kept.iter().map(|&i| block.pixel[i] as usize);
        if finish.columns.has(Columns::NORMALS) {
            let normals = pixels.clone().map(|at| self.normal(at, finish));
            points.normals.extend(normals);
        }
        if finish.columns.has(Columns::COLORS) {
            self.add_colors(kept, (block, seen), finish, &mut points.colors);
        }
        if finish.columns.has(Columns::CONFIDENCES) {
            let confidence = finish.confidence.as_ref();
            let of = |at: usize| confidence.map_or(1.0, |map| map.values()[at]);
            points.confidences.extend(pixels.map(of));
        }
    }

    fn agreeing<'s>(
        &'s self,
        i: usize,
        seen: &'s [Seen],
    ) -> impl Iterator<Item = (&'s Source, &'s Seen)> {
        let pairs = self.sources.iter().zip(seen);
        pairs.filter(move |(_, seen)| seen.agrees[i] == 1)
    }

    fn displacement(&self, i: usize, point: DVec3, seen: &[Seen]) -> DVec3 {
        let agreeing: Vec<(DVec3, f32)> = self
            .agreeing(i, seen)
            .map(|(source, seen)| (source.center, seen.ratio[i]))
            .collect();
        mean_displacement(point, &agreeing)
    }

    /// The given normal or the fitted one, in the world; zero where there is none.
    fn normal(&self, at: usize, finish: &Finish<'_>) -> Vec3 {
        let (column, row) = (at % self.samples.width(), at / self.samples.width());
        let in_cam = match &finish.normals {
            Some(map) => Some(Vec3::from(map.values()[at])),
            None => normals::from_depth(
                &self.samples,
                &self.view.camera,
                (column, row),
                self.options.similar_depth,
            ),
        };
        in_cam.map_or(Vec3::ZERO, |normal| {
            self.view
                .pose
                .direction_to_world(normal.as_dvec3())
                .as_vec3()
        })
    }

    /// The colours of the reference's image, or the means over all images that agree: the
    /// reference's bilinear, a source's at its nearest pixel. White without an image.
    fn add_colors(
        &self,
        kept: &[usize],
        (block, seen): (&Block, &[Seen]),
        finish: &Finish<'_>,
        colors: &mut Vec<[u8; 3]>,
    ) {
        let mut sums = [[0u32; 3]; BLOCK];
        let mut counts = [0u32; BLOCK];
        if let Some(image) = &finish.image {
            let scale = self.scale(image);
            for &i in kept {
                let own = sampling::color(image, center(block, i) * scale);
                sums[i] = own.map(u32::from);
                counts[i] = 1;
            }
        }
        // Source by source, so that the fetches from its image do not wait for each other.
        let all = self.options.colors == Colors::Mean;
        for (source, seen) in self.sources.iter().zip(seen).filter(|_| all) {
            let Some(image) = &source.image else { continue };
            for &i in kept {
                let color = image.nearest(seen.x[i], seen.y[i]);
                for (sum, value) in sums[i].iter_mut().zip(color) {
                    *sum += seen.agrees[i] * u32::from(value);
                }
                counts[i] += seen.agrees[i];
            }
        }
        colors.extend(kept.iter().map(|&i| match counts[i] {
            0 => [255; 3],
            count => sums[i].map(|sum| rounded_mean(sum, count)),
        }));
    }

    /// Image pixels per depth pixel.
    fn scale(&self, image: &ColorImage) -> DVec2 {
        DVec2::new(
            f64::from(image.width()) / f64::from(self.view.camera.width()),
            f64::from(image.height()) / f64::from(self.view.camera.height()),
        )
    }
}

/// The mean of `count` ≥ 1 bytes whose sum is `sum`, to the nearest.
fn rounded_mean(sum: u32, count: u32) -> u8 {
    u8::try_from((sum + count / 2) / count).unwrap_or(u8::MAX)
}

/// Continuous image coordinates of entry `i`.
fn center(block: &Block, i: usize) -> DVec2 {
    DVec2::new(f64::from(block.u[i]), f64::from(block.v[i]))
}

/// Fused depth of entry `i`.
fn fused(block: &Block, consensus: &Consensus, i: usize) -> f64 {
    f64::from(block.depth[i]) + f64::from(consensus.delta[i])
}

fn number(index: usize) -> u32 {
    u32::try_from(index).unwrap_or(u32::MAX)
}
