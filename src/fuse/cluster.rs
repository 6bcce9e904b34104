//! `cluster`: connected pixels that agree in position and normal become one point, as COLMAP's
//! stereo_fusion does. One pixel after another in a fixed order: a pixel joins the first cluster
//! that reaches it, so the order is part of the result and nothing runs in parallel.

use super::counts::FuseCounts;
use super::engine::{FuseInputs, columns};
use super::normals;
use super::options::FuseOptions;
use super::points::{Columns, PointSink, Points};
use super::samples::{Filters, Samples, confidence, prepare};
use crate::error::{Error, Result};
use glam::{DVec2, DVec3, Vec3};
use mvs_datasets::scene::{ColorImage, NormalMap};

/// COLMAP's limits on one cluster.
const MAX_STEPS: u32 = 100;
const MAX_PIXELS: usize = 10_000;

/// A view's maps while they are needed.
struct Loaded {
    samples: Samples,
    normals: Option<NormalMap>,
    image: Option<ColorImage>,
    last_used: usize,
}

impl Loaded {
    fn bytes(&self) -> usize {
        let pixels = self.samples.bytes() / size_of::<f32>();
        self.samples.bytes()
            + self.normals.as_ref().map_or(0, |_| 12 * pixels)
            + self
                .image
                .as_ref()
                .map_or(0, |image| 3 * image.values().len())
    }
}

struct Clusters<'a> {
    inputs: &'a FuseInputs<'a>,
    options: &'a FuseOptions,
    columns: Columns,
    loaded: Vec<Option<Loaded>>,
    /// Bytes of all that is loaded.
    held: usize,
    /// Pixels that are part of a cluster, per view, a bit each; empty before the first.
    used: Vec<Vec<u64>>,
    max_pixel2: f64,
    min_cosine: f64,
    /// The view whose clusters are grown.
    now: usize,
}

/// A pixel of a cluster.
struct Member {
    view: usize,
    position: DVec3,
    normal: Vec3,
    color: [u8; 3],
}

/// A pixel to look at.
#[derive(Clone, Copy)]
struct Candidate {
    view: usize,
    column: u32,
    row: u32,
    steps: u32,
}

/// Fuses all views into clusters; the points go to `sink` by the view of their first pixel.
pub(super) fn fuse_clusters(
    inputs: &FuseInputs<'_>,
    options: &FuseOptions,
    sink: &mut dyn PointSink,
) -> Result<FuseCounts> {
    let count = inputs.maps.count();
    let mut clusters = Clusters {
        inputs,
        options,
        columns: columns(inputs.maps, options).and(Columns::VISIBLE.when(sink.wants_visible())),
        loaded: (0..count).map(|_| None).collect(),
        held: 0,
        used: vec![Vec::new(); count],
        max_pixel2: options.max_pixel_error * options.max_pixel_error,
        min_cosine: options.max_normal_angle.to_radians().cos(),
        now: 0,
    };
    inputs.progress.begin("clustering", count as u64);
    let mut total = FuseCounts::default();
    for view in 0..count {
        inputs.progress.check()?;
        clusters.now = view;
        let (points, counts) = clusters.view(view)?;
        sink.take(&points)?;
        sink.view_done()?;
        total = total.plus(counts);
        inputs.progress.advance(1);
    }
    Ok(total)
}

impl Clusters<'_> {
    /// The clusters that start in `view`.
    fn view(&mut self, view: usize) -> Result<(Points, FuseCounts)> {
        self.load(view)?;
        let left_out = |loaded: &Loaded| loaded.samples.left_out();
        let mut counts = self.loaded[view]
            .as_ref()
            .map_or_else(FuseCounts::default, left_out);
        let confidences = confidence(self.inputs.maps, view)?;
        let mut points = Points::default();
        let (mut members, mut stack) = (Vec::new(), Vec::new());
        let camera = self.inputs.maps.view(view).camera;
        for row in 0..camera.height() {
            for column in 0..camera.width() {
                stack.push(Candidate {
                    view,
                    column,
                    row,
                    steps: 0,
                });
                self.grow(&mut stack, &mut members)?;
                let size = members.len() as u64;
                if members.is_empty() {
                    continue;
                }
                if members.len() <= self.options.min_sources {
                    counts.inconsistent += size;
                    continue;
                }
                let at = (row * camera.width() + column) as usize;
                let confidence = confidences.as_ref().map_or(1.0, |map| map.values()[at]);
                if self.add_point(view, &members, confidence, &mut points) {
                    counts.fused += 1;
                    counts.merged += size - 1;
                } else {
                    counts.outside += size;
                }
            }
        }
        Ok((points, counts))
    }

    /// Puts the pixels of the cluster that starts at the one on the stack into `members`; they are
    /// used up by it. The stack is empty afterwards.
    fn grow(&mut self, stack: &mut Vec<Candidate>, members: &mut Vec<Member>) -> Result<()> {
        members.clear();
        while let Some(candidate) = stack.pop() {
            self.load(candidate.view)?;
            let Some(member) = self.join(candidate, members.first()) else {
                continue;
            };
            let position = member.position;
            members.push(member);
            if members.len() >= MAX_PIXELS {
                stack.clear();
            } else if candidate.steps < MAX_STEPS {
                self.push_neighbours(candidate, position, stack);
            }
        }
        Ok(())
    }

    /// The candidate of a loaded view as a member, if it has a depth, is unused and agrees with the
    /// first member.
    fn join(&mut self, candidate: Candidate, first: Option<&Member>) -> Option<Member> {
        let Candidate {
            view: index,
            column,
            row,
            ..
        } = candidate;
        let view = self.inputs.maps.view(index);
        let loaded = self.loaded[index].as_ref()?;
        let (at_column, at_row) = (column as usize, row as usize);
        let stored = loaded.samples.row(at_row)[at_column];
        let bit = at_row * loaded.samples.width() + at_column;
        let used = self.used[index].get_mut(bit / 64)?;
        if stored <= 0.0 || *used >> (bit % 64) & 1 == 1 {
            return None;
        }
        let depth = f64::from(loaded.samples.unit().convert(stored));
        let pixel = DVec2::new(f64::from(column) + 0.5, f64::from(row) + 0.5);
        if let Some(first) = first {
            let seen = view.pose.to_cam(first.position);
            let projected = view.camera.project(seen)?;
            let agrees = (seen.z / depth - 1.0).abs() <= self.options.max_depth_error
                && projected.distance_squared(pixel) <= self.max_pixel2;
            if !agrees {
                return None;
            }
        }
        let in_cam = match &loaded.normals {
            Some(map) => Some(Vec3::from(map.get(column, row))),
            None => normals::from_depth(
                &loaded.samples,
                &view.camera,
                (at_column, at_row),
                self.options.similar_depth,
            ),
        };
        let normal = in_cam.map_or(Vec3::ZERO, |normal| {
            view.pose.direction_to_world(normal.as_dvec3()).as_vec3()
        });
        if first.is_some_and(|first| f64::from(first.normal.dot(normal)) < self.min_cosine) {
            return None;
        }
        *used |= 1 << (bit % 64);
        Some(Member {
            view: index,
            position: view.pose.to_world(view.camera.ray(pixel) * depth),
            normal,
            color: color(loaded, pixel),
        })
    }

    /// Where the candidate's point appears in its view's sources.
    fn push_neighbours(&self, from: Candidate, position: DVec3, stack: &mut Vec<Candidate>) {
        let sources = self.inputs.maps.sources(from.view);
        for &source in &sources[..self.options.sources_used(sources.len())] {
            let view = self.inputs.maps.view(source);
            let Some(pixel) = view.camera.project(view.pose.to_cam(position)) else {
                continue;
            };
            let (width, height) = (view.camera.width(), view.camera.height());
            let inside = pixel.x >= 0.0
                && pixel.y >= 0.0
                && pixel.x < f64::from(width)
                && pixel.y < f64::from(height);
            if inside {
                #[allow(
                    clippy::cast_possible_truncation,
                    clippy::cast_sign_loss,
                    reason = "inside the image"
                )]
                stack.push(Candidate {
                    view: source,
                    column: pixel.x as u32,
                    row: pixel.y as u32,
                    steps: from.steps + 1,
                });
            }
        }
    }

    /// Adds the cluster's medians; false where they lie outside of the region.
    fn add_point(
        &self,
        view: usize,
        members: &[Member],
        confidence: f32,
        points: &mut Points,
    ) -> bool {
        let along = |axis: usize| median(members.iter().map(|member| member.position[axis]));
        let position = DVec3::new(along(0), along(1), along(2));
        if self.inputs.region.is_some_and(|wanted| !wanted(position)) {
            return false;
        }
        let mut views: Vec<usize> = members.iter().map(|member| member.view).collect();
        views.sort_unstable();
        views.dedup();
        let number = |index: usize| u32::try_from(index).unwrap_or(u32::MAX);
        points.positions.push(position);
        points.view_counts.push(number(views.len()));
        points.violations.push(0);
        let reference = self.inputs.maps.view(view);
        let depth = reference.pose.to_cam(position).z;
        #[allow(clippy::cast_possible_truncation, reason = "a size for display")]
        points
            .scales
            .push((depth / reference.camera.focal().x) as f32);
        if self.columns.has(Columns::VISIBLE) {
            points.visible_in.push(number(view));
            let others = views.iter().filter(|&&other| other != view);
            points.visible_in.extend(others.map(|&other| number(other)));
        }
        if self.columns.has(Columns::NORMALS) {
            let of = |axis: usize| median(members.iter().map(|m| f64::from(m.normal[axis])));
            let normal = DVec3::new(of(0), of(1), of(2)).normalize_or_zero();
            points.normals.push(normal.as_vec3());
        }
        if self.columns.has(Columns::COLORS) {
            let of = |channel: usize| median(members.iter().map(|m| f64::from(m.color[channel])));
            points
                .colors
                .push([0, 1, 2].map(|channel| super::sampling::to_byte(of(channel))));
        }
        if self.columns.has(Columns::CONFIDENCES) {
            points.confidences.push(confidence);
        }
        true
    }

    /// The maps of a view, read if they are not at hand; others go where they do not fit into the
    /// budget, those first that were not looked at for the longest time. What the present view's
    /// clusters have touched stays in any case, else they might be read over and over.
    fn load(&mut self, index: usize) -> Result<()> {
        if let Some(loaded) = &mut self.loaded[index] {
            loaded.last_used = self.now;
            return Ok(());
        }
        let loaded = self.read(index)?;
        self.held += loaded.bytes();
        self.make_room();
        let pixels = loaded.samples.width() * loaded.samples.height();
        self.used[index].resize(pixels.div_ceil(64), 0);
        self.loaded[index] = Some(loaded);
        Ok(())
    }

    fn read(&self, index: usize) -> Result<Loaded> {
        let maps = self.inputs.maps;
        let samples = prepare(maps, index, self.options, Filters::All)?;
        let image = if self.columns.has(Columns::COLORS) {
            maps.image(index)?
        } else {
            None
        };
        let normals = maps.normals(index)?;
        let size = (
            maps.view(index).camera.width(),
            maps.view(index).camera.height(),
        );
        if normals.as_ref().is_some_and(|map| map.size() != size) {
            let what = format!("view {}", maps.view(index).id);
            return Err(Error::invalid(
                what,
                "expected normals of the depth map's size",
            ));
        }
        Ok(Loaded {
            samples,
            normals,
            image,
            last_used: self.now,
        })
    }

    /// Lets go of the maps used least recently, until the rest fits into the budget.
    fn make_room(&mut self) {
        while self.held > self.inputs.memory {
            let last_used = |slot: &Option<Loaded>| slot.as_ref().map(|l| l.last_used);
            let idle = self.loaded.iter_mut();
            let idle = idle.filter(|slot| last_used(slot).is_some_and(|used| used < self.now));
            let Some(oldest) = idle
                .min_by_key(|slot| last_used(slot))
                .and_then(Option::take)
            else {
                return;
            };
            self.held -= oldest.bytes();
        }
    }
}

fn color(loaded: &Loaded, pixel: DVec2) -> [u8; 3] {
    let Some(image) = &loaded.image else {
        return [255; 3];
    };
    #[allow(clippy::cast_precision_loss, reason = "image sizes are far below 2^52")]
    let scale = DVec2::new(
        f64::from(image.width()) / loaded.samples.width() as f64,
        f64::from(image.height()) / loaded.samples.height() as f64,
    );
    super::sampling::color(image, pixel * scale)
}

/// The middle value, of an even number the mean of the two middle ones. At least one value.
fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    let middle = values.len() / 2;
    if values.len() % 2 == 1 {
        values[middle]
    } else {
        0.5 * (values[middle - 1] + values[middle])
    }
}
