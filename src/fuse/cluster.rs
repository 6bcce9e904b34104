//! `cluster`: connected pixels that agree in position and normal become one point, as COLMAP's
//! stereo_fusion does. One pixel after another in a fixed order: a pixel joins the first cluster
//! that reaches it, so the order is part of the result and nothing runs in parallel but reading.
//!
//! A pixel's ray goes through its centre, (column + 0.5, row + 0.5), as everywhere here; COLMAP's own fusion takes
//! (column, row), so that its points lie half a pixel to the upper left of these.

use super::counts::FuseCounts;
use super::engine::{FuseInputs, columns};
use super::options::FuseOptions;
use super::points::{Columns, PointSink, Points};
use super::samples::confidence;
use super::sight::{EIGHT, Onlookers, Sightings};
use super::tiles::{CLUSTER_BYTES, Packed, Pixel, Tiles};
use crate::error::Result;
use crate::parallel;
use glam::{DVec2, DVec3, Vec3};
use mvs_datasets::scene::View;

/// COLMAP's limits on one cluster.
const MAX_STEPS: u32 = 100;
const MAX_PIXELS: usize = 10_000;

struct Clusters<'a> {
    inputs: &'a FuseInputs<'a>,
    options: &'a FuseOptions,
    columns: Columns,
    tiles: Tiles<'a>,
    /// By view: the map's width, and which pixels are part of a cluster, a bit each.
    used: Vec<(usize, Vec<u64>)>,
    /// The sources of each view, as far as they are used.
    onlookers: Vec<Onlookers>,
    /// Where the present cluster's first member appears, by view; of other clusters' where the
    /// number differs.
    sightings: Vec<(u64, Option<Sighting>)>,
    /// The present cluster's number, from 1.
    cluster: u64,
    max_pixel2: f64,
    min_cosine: f64,
    room: Room,
}

/// Used again for every cluster.
#[derive(Default)]
struct Room {
    members: Vec<Member>,
    stack: Vec<Candidate>,
    values: Vec<f64>,
    /// Where the candidate's point appears in its view's sources.
    seen: Vec<Sightings>,
    /// Pixels that have been asked for: view, place, and the depth of the first member's point there.
    asked: Vec<(usize, (u32, u32), f64)>,
}

/// Where a point appears in a view.
#[derive(Clone, Copy)]
struct Sighting {
    pixel: DVec2,
    /// z-depth there.
    depth: f64,
}

impl Sighting {
    /// Of `point`; `None` unless it lies in front.
    fn of(point: DVec3, view: &View) -> Option<Self> {
        let in_cam = view.pose.to_cam(point);
        let pixel = view.camera.project(in_cam)?;
        Some(Self {
            pixel,
            depth: in_cam.z,
        })
    }
}

/// A pixel of a cluster.
struct Member {
    view: usize,
    position: DVec3,
    normal: Vec3,
    color: [u8; 3],
}

/// A pixel to look at; it agrees with the cluster's first member.
#[derive(Clone, Copy)]
struct Candidate {
    view: usize,
    place: (u32, u32),
    steps: u32,
    pixel: Pixel,
}

/// Fuses all views into clusters; the points go to `sink` by the view of their first pixel.
pub(super) fn fuse_clusters(
    inputs: &FuseInputs<'_>,
    options: &FuseOptions,
    sink: &mut dyn PointSink,
) -> Result<FuseCounts> {
    let count = inputs.maps.count();
    let columns = columns(inputs.maps, options).and(Columns::VISIBLE.when(sink.wants_visible()));
    let (tiles, mut total) = read(inputs, options, columns)?;
    let mut clusters = Clusters {
        inputs,
        options,
        columns,
        tiles,
        used: (0..count)
            .map(|view| {
                let view = inputs.maps.view(view);
                let words = vec![0; pixels(view).div_ceil(64)];
                (view.camera.width() as usize, words)
            })
            .collect(),
        onlookers: (0..count)
            .map(|view| {
                let sources = inputs.maps.sources(view);
                let used = &sources[..options.sources_used(sources.len())];
                Onlookers::new(used.iter().map(|&source| inputs.maps.view(source)))
            })
            .collect(),
        sightings: vec![(0, None); count],
        cluster: 0,
        max_pixel2: options.max_pixel_error * options.max_pixel_error,
        min_cosine: libm::cos(options.max_normal_angle.to_radians()),
        room: Room::default(),
    };
    inputs.progress.begin("clustering", count as u64);
    for view in 0..count {
        inputs.progress.check()?;
        let (points, counts) = clusters.view(view)?;
        sink.take(&points)?;
        sink.view_done()?;
        total = total.plus(counts);
        inputs.progress.advance(1);
    }
    if !in_memory(inputs) {
        (0..count as u64).try_for_each(|view| inputs.scratch.discard(view))?;
    }
    Ok(total)
}

fn pixels(view: &View) -> usize {
    view.camera.width() as usize * view.camera.height() as usize
}

/// Whether all tiles fit into the budget even if no pixel is empty.
fn in_memory(inputs: &FuseInputs<'_>) -> bool {
    let all = (0..inputs.maps.count()).map(|view| pixels(inputs.maps.view(view)));
    all.sum::<usize>().saturating_mul(CLUSTER_BYTES) <= inputs.memory
}

/// The tiles of all views, and what the filters left out.
fn read<'a>(
    inputs: &FuseInputs<'a>,
    options: &FuseOptions,
    columns: Columns,
) -> Result<(Tiles<'a>, FuseCounts)> {
    let (maps, keep) = (inputs.maps, in_memory(inputs));
    inputs.progress.begin("reading", maps.count() as u64);
    let read = |index| {
        inputs.progress.check()?;
        let (mut packed, left_out) = Packed::new(maps, index, options, columns)?;
        if !keep {
            Tiles::store(inputs.scratch, index, &mut packed)?;
        }
        inputs.progress.advance(1);
        Ok((packed, left_out))
    };
    let mut tiles = Tiles::new(inputs.scratch, inputs.memory);
    let mut counts = FuseCounts::default();
    for (index, (packed, left_out)) in (0..).zip(parallel::try_map(maps.count(), read)?) {
        tiles.add(maps.view(index).camera.width() as usize, packed);
        counts = counts.plus(left_out);
    }
    Ok((tiles, counts))
}

impl Clusters<'_> {
    /// The clusters that start in `view`.
    fn view(&mut self, view: usize) -> Result<(Points, FuseCounts)> {
        let confidences = match self.columns.has(Columns::CONFIDENCES) {
            true => confidence(self.inputs.maps, view)?,
            false => None,
        };
        let mut counts = FuseCounts::default();
        let mut points = Points::default();
        let camera = self.inputs.maps.view(view).camera;
        for row in 0..camera.height() {
            for column in 0..camera.width() {
                if !self.grow(view, (column, row))? {
                    continue;
                }
                let size = self.room.members.len() as u64;
                if self.room.members.len() <= self.options.min_sources {
                    counts.inconsistent += size;
                    continue;
                }
                let at = (row * camera.width() + column) as usize;
                let confidence = confidences.as_ref().map_or(1.0, |map| map.values()[at]);
                if self.add_point(view, confidence, &mut points) {
                    counts.fused += 1;
                    counts.merged += size - 1;
                } else {
                    counts.outside += size;
                }
            }
        }
        Ok((points, counts))
    }

    /// Puts the pixels of the cluster that starts at a pixel into the room's members; they are used up by
    /// it. False where that pixel has no depth or is used.
    fn grow(&mut self, view: usize, place: (u32, u32)) -> Result<bool> {
        if self.is_used(view, place) {
            return Ok(false);
        }
        let Some(pixel) = self.tiles.pixel(view, place)? else {
            return Ok(false);
        };
        let mut room = std::mem::take(&mut self.room);
        room.members.clear();
        self.cluster += 1;
        room.stack.push(Candidate {
            view,
            place,
            steps: 0,
            pixel,
        });
        while let Some(candidate) = room.stack.pop() {
            // It may have joined by another way.
            if self.is_used(candidate.view, candidate.place) {
                continue;
            }
            let member = self.join(candidate)?;
            let position = member.position;
            room.members.push(member);
            if room.members.len() >= MAX_PIXELS {
                room.stack.clear();
            } else if candidate.steps < MAX_STEPS {
                self.push_neighbours(candidate, position, &mut room)?;
            }
        }
        self.room = room;
        Ok(true)
    }

    /// The bit of a pixel: its word and its place there.
    fn bit(&self, view: usize, (column, row): (u32, u32)) -> (usize, u32) {
        let at = row as usize * self.used[view].0 + column as usize;
        (at / 64, (at % 64) as u32)
    }

    fn is_used(&self, view: usize, place: (u32, u32)) -> bool {
        let (word, bit) = self.bit(view, place);
        self.used[view].1[word] >> bit & 1 == 1
    }

    /// Uses up the candidate.
    fn join(&mut self, candidate: Candidate) -> Result<Member> {
        let Candidate {
            view: index,
            place,
            pixel,
            ..
        } = candidate;
        let (word, bit) = self.bit(index, place);
        self.used[index].1[word] |= 1 << bit;
        let view = self.inputs.maps.view(index);
        let color = match self.columns.has(Columns::COLORS) {
            true => self.tiles.color(index, place)?,
            false => [255; 3],
        };
        Ok(Member {
            view: index,
            position: (view.pose).to_world(view.camera.ray(center(place)) * pixel.depth),
            normal: pixel.normal,
            color,
        })
    }

    /// Where the candidate's point, at `position`, appears in its view's sources, if those pixels agree
    /// with the first member.
    fn push_neighbours(&mut self, from: Candidate, position: DVec3, room: &mut Room) -> Result<()> {
        let Some(first) = room.members.first() else {
            return Ok(());
        };
        if from.steps == 0 {
            // In its own view it lies at its pixel's centre: found by projection, pixels at whole distances from
            // there would count or not by rounding.
            let (pixel, depth) = (center(from.place), from.pixel.depth);
            self.sightings[from.view] = (self.cluster, Some(Sighting { pixel, depth }));
        }
        let sources = self.inputs.maps.sources(from.view);
        self.onlookers[from.view].see(position, &mut room.seen);
        room.asked.clear();
        for (sources, seen) in sources.chunks(EIGHT).zip(&room.seen) {
            for (i, &source) in sources.iter().enumerate() {
                if seen.x[i] < 0.0 {
                    continue;
                }
                #[allow(
                    clippy::cast_possible_truncation,
                    clippy::cast_sign_loss,
                    reason = "inside the image"
                )]
                let place = (seen.x[i] as u32, seen.y[i] as u32);
                if self.is_used(source, place) {
                    continue;
                }
                self.tiles.ask(source, place);
                let known = &mut self.sightings[source];
                if from.steps == 0 {
                    let pixel = DVec2::new(seen.x[i], seen.y[i]);
                    let depth = seen.depth[i];
                    *known = (self.cluster, Some(Sighting { pixel, depth })); // the first member's own
                } else if known.0 != self.cluster {
                    let view = self.inputs.maps.view(source);
                    *known = (self.cluster, Sighting::of(first.position, view));
                }
                let Some(expected) = known.1 else { continue };
                if expected.pixel.distance_squared(center(place)) <= self.max_pixel2 {
                    room.asked.push((source, place, expected.depth));
                }
            }
        }
        for &(source, place, expected_depth) in &room.asked {
            let Some(pixel) = self.tiles.pixel(source, place)? else {
                continue;
            };
            let near = (expected_depth / pixel.depth - 1.0).abs() <= self.options.max_depth_error;
            let turned = f64::from(first.normal.dot(pixel.normal)) < self.min_cosine;
            if near && !turned {
                room.stack.push(Candidate {
                    view: source,
                    place,
                    steps: from.steps + 1,
                    pixel,
                });
            }
        }
        Ok(())
    }

    /// Adds the cluster's medians; false where they lie outside of the region.
    fn add_point(&mut self, view: usize, confidence: f32, points: &mut Points) -> bool {
        let Room {
            members, values, ..
        } = &mut self.room;
        let mut along = |axis: usize| median(members.iter().map(|m| m.position[axis]), values);
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
            let mut of =
                |axis: usize| median(members.iter().map(|m| f64::from(m.normal[axis])), values);
            let normal = DVec3::new(of(0), of(1), of(2)).normalize_or_zero();
            points.normals.push(normal.as_vec3());
        }
        if self.columns.has(Columns::COLORS) {
            let channel = |at: usize| members.iter().map(move |m| f64::from(m.color[at]));
            let of = |at: usize| super::sampling::to_byte(median(channel(at), values));
            points.colors.push([0, 1, 2].map(of));
        }
        if self.columns.has(Columns::CONFIDENCES) {
            points.confidences.push(confidence);
        }
        true
    }
}

fn center((column, row): (u32, u32)) -> DVec2 {
    DVec2::new(f64::from(column) + 0.5, f64::from(row) + 0.5)
}

/// The middle value, of an even number the mean of the two middle ones. At least one value; `room` is
/// overwritten.
fn median(values: impl Iterator<Item = f64>, room: &mut Vec<f64>) -> f64 {
    room.clear();
    room.extend(values);
    let middle = room.len() / 2;
    let odd = room.len() % 2 == 1;
    let (below, &mut upper, _) = room.select_nth_unstable_by(middle, f64::total_cmp);
    let lower = below.iter().copied().max_by(f64::total_cmp);
    match lower {
        Some(lower) if !odd => 0.5 * (lower + upper),
        _ => upper,
    }
}
