//! One reference view against its sources: bands of rows to points, or to the depths of the next
//! pass.

use super::counts::FuseCounts;
use super::kernel::{Block, Pair, Seen};
use super::normals;
use super::options::{Colors, FuseOptions};
use super::points::{Columns, Points};
use super::rules::{Bounds, Consensus, Rule, disparity_scale, mean_displacement};
use super::samples::Samples;
use super::sampling;
use glam::{DVec2, DVec3, Vec3};
use mvs_datasets::scene::{ColorImage, NormalMap, Raster, View};
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
    pub(super) image: Option<Arc<ColorImage>>,
    /// Centre in the reference's camera frame.
    pub(super) center: DVec3,
    /// See [`disparity_scale`].
    pub(super) disparity: f32,
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

    /// The points of `rows`, and what became of the pixels that had a depth.
    pub(super) fn points(&self, rows: Range<usize>, finish: &Finish<'_>) -> (Points, FuseCounts) {
        let mut points = Points::default();
        let mut counts = FuseCounts::default();
        self.for_each_block(rows, |block, seen, consensus| {
            for i in 0..block.len {
                let fate = if !consensus.enough[i] {
                    &mut counts.inconsistent
                } else if self.options.guard && consensus.violations[i] > consensus.count[i] {
                    &mut counts.contradicted
                } else if self.add_point(i, (block, seen, consensus), finish, &mut points) {
                    &mut counts.fused
                } else {
                    &mut counts.outside
                };
                *fate += 1;
            }
        });
        (points, counts)
    }

    /// Calls `f` with every block of pixels that have a depth, and what the sources say.
    fn for_each_block(&self, rows: Range<usize>, mut f: impl FnMut(&Block, &[Seen], &Consensus)) {
        let bounds = Bounds::new(self.view, self.options);
        let disparity: Vec<f32> = self.sources.iter().map(|source| source.disparity).collect();
        let taps = self.rule.taps(self.options);
        let mut seen = vec![Seen::new(); self.sources.len()];
        let mut finish = |block: &mut Block| {
            for (source, seen) in self.sources.iter().zip(&mut seen) {
                source.pair.look(block, &source.samples, taps, seen);
            }
            let consensus = self
                .rule
                .decide(block, &mut seen, &bounds, self.needed, &disparity);
            f(block, &seen, &consensus);
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

    /// Adds the point of entry `i`; false where it lies outside of the region.
    fn add_point(
        &self,
        i: usize,
        (block, seen, consensus): (&Block, &[Seen], &Consensus),
        finish: &Finish<'_>,
        points: &mut Points,
    ) -> bool {
        let pixel = DVec2::new(f64::from(block.u[i]), f64::from(block.v[i]));
        let depth = f64::from(block.depth[i]) + f64::from(consensus.delta[i]);
        let mut in_cam = self.view.camera.ray(pixel) * depth;
        if self.rule == Rule::Disparity {
            in_cam += self.displacement(i, in_cam, seen);
        }
        let position = self.view.pose.to_world(in_cam);
        if finish.region.is_some_and(|wanted| !wanted(position)) {
            return false;
        }
        points.positions.push(position);
        points.view_counts.push(consensus.count[i] + 1);
        points.violations.push(consensus.violations[i]);
        let focal = 0.5 * (self.view.camera.focal().x + self.view.camera.focal().y);
        #[allow(clippy::cast_possible_truncation, reason = "a size for display")]
        points.scales.push((depth / focal) as f32);
        points.visible_in.push(number(self.number));
        let agreeing = self
            .agreeing(i, seen)
            .map(|(source, _)| number(source.number));
        points.visible_in.extend(agreeing);
        self.add_columns(i, (block, seen), finish, points);
        true
    }

    fn add_columns(
        &self,
        i: usize,
        (block, seen): (&Block, &[Seen]),
        finish: &Finish<'_>,
        points: &mut Points,
    ) {
        let at = block.pixel[i] as usize;
        if finish.columns.has(Columns::NORMALS) {
            points.normals.push(self.normal(at, finish));
        }
        if finish.columns.has(Columns::COLORS) {
            points.colors.push(self.color(i, (block, seen), finish));
        }
        if finish.columns.has(Columns::CONFIDENCES) {
            let confidence = finish
                .confidence
                .as_ref()
                .map_or(1.0, |map| map.values()[at]);
            points.confidences.push(confidence);
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

    /// The colour of the reference's image, or the mean over all images that agree: the reference's
    /// bilinear, a source's at its nearest pixel.
    fn color(&self, i: usize, (block, seen): (&Block, &[Seen]), finish: &Finish<'_>) -> [u8; 3] {
        let pixel = DVec2::new(f64::from(block.u[i]), f64::from(block.v[i]));
        let own = finish
            .image
            .as_ref()
            .map(|image| sampling::color(image, pixel * self.scale(image)));
        if self.options.colors == Colors::Reference {
            return own.unwrap_or([255; 3]);
        }
        let mut sum = [0u32; 3];
        let mut count = 0;
        let mut add = |color: [u8; 3]| {
            count += 1;
            for (sum, value) in sum.iter_mut().zip(color) {
                *sum += u32::from(value);
            }
        };
        own.into_iter().for_each(&mut add);
        for (source, seen) in self.agreeing(i, seen) {
            if let Some(image) = &source.image {
                add(nearest_color(
                    image,
                    &source.samples,
                    (seen.x[i], seen.y[i]),
                ));
            }
        }
        sum.map(|sum| {
            if count == 0 {
                255
            } else {
                rounded_mean(sum, count)
            }
        })
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

/// The pixel of a source's image at (`x`, `y`) as [`Seen`] has them, clamped to the image.
#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    clippy::cast_precision_loss,
    reason = "positions on an image; `as` saturates"
)]
fn nearest_color(image: &ColorImage, samples: &Samples, (x, y): (f32, f32)) -> [u8; 3] {
    let along = |at: f32, map: usize, size: u32| {
        let scale = size as f32 / map as f32;
        (((at - 0.5) * scale) as u32).min(size - 1)
    };
    let column = along(x, samples.width(), image.width());
    let row = along(y, samples.height(), image.height());
    image.get(column, row)
}

fn number(index: usize) -> u32 {
    u32::try_from(index).unwrap_or(u32::MAX)
}
