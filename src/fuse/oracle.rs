//! `geo`, `dynamic` and `gipuma` pixel by pixel in f64, as plainly as they can be said: what the engine is
//! held to.

use super::geometry::PairGeometry;
use super::sampling;
use super::{Estimate, FuseCounts, FuseMode, FuseOptions};
use glam::{DVec2, DVec3};

/// One point before it joins the cloud.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Point {
    pub(super) position: DVec3,
    pub(super) color: [u8; 3],
    pub(super) view_count: u32,
    pub(super) confidence: f32,
}

/// The points of some rows of one reference view, and what became of the rest.
#[derive(Debug, Default)]
pub(super) struct Band {
    pub(super) points: Vec<Point>,
    pub(super) counts: FuseCounts,
}

/// A reference view and its sources, ready to test pixels.
pub(super) struct Reference<'a> {
    estimate: &'a Estimate,
    sources: Vec<(PairGeometry, &'a Estimate)>,
    options: &'a FuseOptions,
}

impl<'a> Reference<'a> {
    pub(super) fn new(estimates: &'a [Estimate], index: usize, options: &'a FuseOptions) -> Self {
        let estimate = &estimates[index];
        let used = options.sources_used(estimate.sources.len());
        let used = estimate.sources[..used].iter();
        let sources = used
            .map(|&source| &estimates[source])
            .map(|source| (PairGeometry::new(&estimate.view, &source.view), source))
            .collect();
        Self {
            estimate,
            sources,
            options,
        }
    }

    /// Fuses the pixels of `rows`.
    pub(super) fn fuse_rows(&self, rows: std::ops::Range<u32>) -> Band {
        let mut band = Band::default();
        for row in rows {
            for column in 0..self.estimate.depth.width() {
                self.fuse_pixel(column, row, &mut band);
            }
        }
        band
    }

    fn fuse_pixel(&self, column: u32, row: u32, band: &mut Band) {
        band.counts.pixels += 1;
        let depth = f64::from(self.estimate.depth.get(column, row));
        if depth <= 0.0 {
            band.counts.empty += 1;
            return;
        }
        let confidence = self.estimate.confidence.as_ref();
        let confidence = confidence.map_or(1.0, |map| map.get(column, row));
        let least = self.options.min_confidence as f32;
        let is_enough = match self.options.mode {
            FuseMode::Gipuma | FuseMode::Cluster => confidence >= least,
            FuseMode::Hkust | FuseMode::Geo | FuseMode::Dynamic => {
                confidence > least || confidence == least && least == 0.0
            }
        };
        if !is_enough {
            band.counts.unconfident += 1;
            return;
        }
        let pixel = DVec2::new(f64::from(column) + 0.5, f64::from(row) + 0.5);
        let judged = match self.options.mode {
            FuseMode::Dynamic => self.dynamic(pixel, depth),
            FuseMode::Gipuma => self.gipuma(pixel, depth),
            _ => self.geo(pixel, depth),
        };
        let Some((agreeing, position)) = judged else {
            band.counts.inconsistent += 1;
            return;
        };
        band.counts.fused += 1;
        band.points.push(Point {
            position,
            color: self.color(pixel),
            view_count: u32::try_from(agreeing + 1).unwrap_or(u32::MAX),
            confidence,
        });
    }

    fn geo(&self, pixel: DVec2, depth: f64) -> Option<(usize, DVec3)> {
        let (agreeing, mean) = self.consensus(pixel, depth);
        let enough = agreeing >= self.options.min_sources;
        enough.then(|| (agreeing, self.position(pixel, mean)))
    }

    /// For some i from 2 to 10, i sources have a pixel error below i/4 and a relative depth error below
    /// i/1300; the mean is over those that meet the widest bounds.
    fn dynamic(&self, pixel: DVec2, depth: f64) -> Option<(usize, DVec3)> {
        let mut errors = Vec::new();
        for (pair, source) in &self.sources {
            let Some(projected) = pair.project(pixel, depth) else {
                continue;
            };
            let sampled = sampling::plain(&source.depth, projected.pixel);
            if sampled > 0.0 {
                let q = sampled / projected.depth - 1.0;
                let (pixels, relative) = (
                    pair.pixel_error(pixel, depth, q),
                    pair.depth_error(depth, q),
                );
                errors.push((pixels, relative, pair.reprojected_depth(depth, q)));
            }
        }
        let meet = |i: f64| {
            let within = |error: &&(f64, f64, f64)| error.0 < i / 4.0 && error.1 < i / 1300.0;
            errors
                .iter()
                .filter(within)
                .map(|error| error.2)
                .collect::<Vec<f64>>()
        };
        let enough = (2..=10).any(|i| meet(f64::from(i)).len() >= i as usize);
        let widest = meet(10.0);
        #[allow(clippy::cast_precision_loss, reason = "a number of views")]
        let mean = (depth + widest.iter().sum::<f64>()) / (widest.len() + 1) as f64;
        enough.then(|| (widest.len(), self.position(pixel, mean)))
    }

    /// Sources whose nearest pixel has nearly the expected disparity; the mean of their points and the
    /// reference's.
    fn gipuma(&self, pixel: DVec2, depth: f64) -> Option<(usize, DVec3)> {
        let view = &self.estimate.view;
        let mut points = vec![self.position(pixel, depth)];
        for (pair, source) in &self.sources {
            let Some(projected) = pair.project(pixel, depth) else {
                continue;
            };
            let place = projected.pixel.floor();
            let size = DVec2::new(
                f64::from(source.depth.width()),
                f64::from(source.depth.height()),
            );
            if place.min_element() < 0.0 || place.x >= size.x || place.y >= size.y {
                continue;
            }
            #[allow(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "inside the map"
            )]
            let sampled = f64::from(source.depth.get(place.x as u32, place.y as u32));
            let apart = view.pose.center_in_world() - source.view.pose.center_in_world();
            let wide = view.camera.focal().x * apart.length();
            let off = (wide / projected.depth - wide / sampled).abs();
            if sampled > 0.0 && off < self.options.max_disparity_error {
                let ray = source.view.camera.ray(projected.pixel);
                points.push(source.view.pose.to_world(ray * sampled));
            }
        }
        let agreeing = points.len() - 1;
        #[allow(clippy::cast_precision_loss, reason = "a number of views")]
        let mean = points.iter().sum::<DVec3>() / points.len() as f64;
        (agreeing >= self.options.min_sources).then_some((agreeing, mean))
    }

    /// How many sources agree with `depth` at `pixel`, and the mean depth of all that do.
    pub(super) fn consensus(&self, pixel: DVec2, depth: f64) -> (usize, f64) {
        let reprojected = self
            .sources
            .iter()
            .filter_map(|(pair, source)| self.agreeing_depth(pair, source, pixel, depth));
        let (count, sum) = reprojected.fold((0, depth), |(count, sum), z| (count + 1, sum + z));
        #[allow(clippy::cast_precision_loss, reason = "a number of views")]
        let mean = sum / (count + 1) as f64;
        (count, mean)
    }

    fn agreeing_depth(
        &self,
        pair: &PairGeometry,
        source: &Estimate,
        pixel: DVec2,
        depth: f64,
    ) -> Option<f64> {
        let projected = pair.project(pixel, depth)?;
        let sampled = sampling::plain(&source.depth, projected.pixel);
        let q = sampled / projected.depth - 1.0;
        let agrees = sampled > 0.0
            && pair.pixel_error(pixel, depth, q) < self.options.max_pixel_error
            && pair.depth_error(depth, q) < self.options.max_depth_error;
        agrees.then(|| pair.reprojected_depth(depth, q))
    }

    fn position(&self, pixel: DVec2, depth: f64) -> DVec3 {
        let view = &self.estimate.view;
        view.pose.to_world(view.camera.ray(pixel) * depth)
    }

    /// The reference image's colour; white without an image.
    fn color(&self, pixel: DVec2) -> [u8; 3] {
        let Some(image) = &self.estimate.image else {
            return [255; 3];
        };
        let camera = &self.estimate.view.camera;
        let scale = DVec2::new(
            f64::from(image.width()) / f64::from(camera.width()),
            f64::from(image.height()) / f64::from(camera.height()),
        );
        sampling::color(image, pixel * scale)
    }
}
