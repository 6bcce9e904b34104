//! Many rays from one point: brought into an order in which neighbours point alike, then traced in packets.

use super::packet::{Packet, RAYS, Room};
use super::triangle::{Ray, longest_axis};
use super::{Hit, Renderer, Visible};
use crate::parallel;
use glam::DVec3;

/// Rays that one thread takes at a time.
const PART: usize = 1 << 14;

/// Bits of a ray's place along each axis of a face of the cube around the origin.
const PLACE_BITS: u32 = 13;

/// Of those, the bits that rays side by side in a view have in common.
const CELL_BITS: u32 = 8;

/// Rays from one point.
#[derive(Debug, Clone, Copy)]
pub(super) struct Bundle<'b> {
    /// In the world.
    pub(super) origin: DVec3,
    pub(super) directions: &'b [DVec3],
    /// Distances between which surface counts.
    pub(super) range: (f64, f64),
}

impl Bundle<'_> {
    /// What each ray meets first.
    pub(super) fn first_hits(&self, renderer: &Renderer<'_>) -> Vec<Option<Hit>> {
        self.in_parts(|order| {
            let mut first: Vec<Option<Visible>> = vec![None; order.len()];
            self.trace(renderer, order, |at, found| {
                let best = first[at].map_or(found, |best| best.nearer(found));
                first[at] = Some(best);
                best.crossing.distance
            });
            first.into_iter().map(|best| best.map(Hit::from)).collect()
        })
    }

    /// Whether each ray meets anything.
    pub(super) fn blocked(&self, renderer: &Renderer<'_>) -> Vec<bool> {
        self.in_parts(|order| {
            let mut blocked = vec![false; order.len()];
            self.trace(renderer, order, |at, _| {
                blocked[at] = true;
                -1.0
            });
            blocked
        })
    }

    /// What `trace` says of the rays with these numbers, of some at a time on all threads; by number.
    fn in_parts<T: Clone + Default + Send>(
        &self,
        trace: impl Fn(&[u32]) -> Vec<T> + Sync + Send,
    ) -> Vec<T> {
        let order = order(self.directions);
        let parts: Vec<&[u32]> = order.chunks(PART).collect();
        let traced = parallel::map(parts.len(), |part| trace(parts[part]));
        let mut all = vec![T::default(); order.len()];
        for (index, found) in order.iter().zip(traced.into_iter().flatten()) {
            all[*index as usize] = found;
        }
        all
    }

    /// Traces the rays with these numbers. Calls `take` with a ray's place among them and surface that it meets,
    /// the nearest of which is among it. It answers with the distance beyond which the ray need not look; below 0
    /// nowhere.
    fn trace(
        &self,
        renderer: &Renderer<'_>,
        order: &[u32],
        mut take: impl FnMut(usize, Visible) -> f64,
    ) {
        let origin = self.origin - renderer.center;
        let mut room = Room::new();
        for (first, some) in (0..).step_by(RAYS).zip(order.chunks(RAYS)) {
            let mut directions = [DVec3::ZERO; RAYS];
            for (direction, &index) in directions.iter_mut().zip(some) {
                *direction = self.directions[index as usize];
            }
            let lines = directions.map(|direction| Ray::new(origin, direction));
            let directions = &directions[..some.len()];
            let mut packet = Packet::new(origin, directions, self.range.1);
            for (ray, &direction) in directions.iter().enumerate() {
                if !packet.has(ray) {
                    let alone = renderer.first_visible(self.origin, direction, self.range);
                    if let Some(visible) = alone {
                        take(first + ray, visible);
                    }
                }
            }
            #[cfg(test)]
            tests::TOGETHER.with(|count| {
                let together = (0..some.len()).filter(|&ray| packet.has(ray)).count();
                count.set(count.get() + together);
            });
            let meet = |ray: usize, triangle: u32| {
                let triangle = triangle as usize;
                let crossing = renderer.cross(&lines[ray], triangle, self.range)?;
                Some(take(first + ray, Visible { triangle, crossing }))
            };
            packet.trace(&renderer.clusters, (renderer.mesh, &mut room), meet);
        }
    }
}

/// The numbers of directions, in an order in which neighbours point alike: along a curve on each face of
/// the cube around their origin.
fn order(directions: &[DVec3]) -> Vec<u32> {
    let numbered = directions.iter().zip(0u64..);
    let mut keys: Vec<u64> = numbered
        .map(|(direction, index)| u64::from(place(direction)) << 32 | index)
        .collect();
    let cell = |key: u64| key >> (32 + 2 * (PLACE_BITS - CELL_BITS));
    let side_by_side = keys.windows(2);
    let near = side_by_side.filter(|two| cell(two[0]) == cell(two[1]));
    if 2 * near.count() > keys.len() {
        // They come in rows, as a view's do: parts of many rows are as good as all, and in the cache.
        parallel::for_each_chunk(&mut keys, PART, |_, part| part.sort_unstable());
    } else {
        parallel::sort(&mut keys);
    }
    #[allow(clippy::cast_possible_truncation, reason = "the index alone")]
    keys.into_iter().map(|key| key as u32).collect()
}

/// A direction's face, then its place on the Z-order curve there.
fn place(direction: &DVec3) -> u32 {
    let axis = longest_axis(*direction);
    let along = direction[axis];
    let [x, y] = [1, 2].map(|other| direction[(axis + other) % 3] / along.abs());
    let steps = f64::from(1u32 << (PLACE_BITS - 1));
    #[allow(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "between 0 and 2^PLACE_BITS; NaN becomes 0"
    )]
    let [x, y] = [x, y].map(|place| (((place + 1.0) * steps) as u32).min((1 << PLACE_BITS) - 1));
    let face = 2 * axis as u32 + u32::from(along < 0.0);
    face << (2 * PLACE_BITS) | spaced(x) << 1 | spaced(y)
}

/// The bits of a number of 16, with room for a bit between each two.
fn spaced(value: u32) -> u32 {
    let mut value = value & 0xffff;
    for (shift, mask) in [
        (8, 0x00ff_00ff),
        (4, 0x0f0f_0f0f),
        (2, 0x3333_3333),
        (1, 0x5555_5555),
    ] {
        value = (value | value << shift) & mask;
    }
    value
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::render::oracle::Oracle;
    use mvs_datasets::scene::Mesh;
    use std::cell::Cell;

    thread_local! {
        /// Rays that went through the tree in packets.
        pub(super) static TOGETHER: Cell<usize> = const { Cell::new(0) };
    }

    /// Rays in rows, as a view's, are sorted part by part; others all together.
    #[test]
    fn orders_have_every_ray_once_and_neighbours_point_alike() {
        let (columns, rows) = (300, 200);
        let at = |index: usize| {
            let (column, row) = (index % columns, index / columns);
            DVec3::new(column as f64 - 150.0, row as f64 - 100.0, 400.0)
        };
        let count = columns * rows;
        let in_rows: Vec<DVec3> = (0..count).map(at).collect();
        // A step that has no factor in common with their number.
        let scattered: Vec<DVec3> = (0..count).map(|index| at(index * 7919 % count)).collect();
        for (directions, is_in_rows) in [(&in_rows, true), (&scattered, false)] {
            let order = order(directions);
            let mut all = order.clone();
            all.sort_unstable();
            assert!(all.iter().copied().eq(0..count as u32));
            let in_parts = order.chunks(PART).enumerate().all(|(part, some)| {
                let mut parts = some.iter().map(|&index| index as usize / PART);
                parts.all(|of| of == part)
            });
            assert_eq!(in_parts, is_in_rows);
            let pairs = order.windows(2).map(|two| {
                let [one, other] = [two[0], two[1]].map(|index| directions[index as usize]);
                (one - other).length()
            });
            let apart: Vec<f64> = pairs.collect();
            let near = apart.iter().filter(|&&apart| apart < 2.0).count();
            assert!(4 * near > 3 * apart.len(), "{near}");
        }
    }

    #[test]
    fn all_rays_that_have_a_direction_travel_in_packets() {
        let corners = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z];
        let faces = vec![[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]];
        let mesh = Mesh::new(corners.to_vec(), faces).unwrap();
        let renderer = Renderer::new(&mesh).unwrap();
        let oracle = Oracle::new(&mesh);
        let (origin, range) = (DVec3::new(2.0, 3.0, 1.5), (0.0, f64::INFINITY));
        let mut directions: Vec<DVec3> = (0..500)
            .map(|step| {
                let (turn, high) = (0.37 * f64::from(step), 0.01 * f64::from(step));
                DVec3::new(
                    -2.0 + 0.6 * turn.sin(),
                    -3.0 + 0.6 * turn.cos(),
                    -3.5 + high,
                )
            })
            .collect();
        directions.extend([DVec3::NAN, DVec3::INFINITY]);
        let bundle = Bundle {
            origin,
            directions: &directions,
            range,
        };
        TOGETHER.set(0);
        let hits = bundle.first_hits(&renderer);
        assert_eq!(TOGETHER.get(), 500);
        let alone = |&direction: &DVec3| oracle.first_hit(origin, direction, range);
        let expected: Vec<Option<Hit>> = directions.iter().map(alone).collect();
        assert_eq!(hits, expected);
        let met = hits.iter().flatten().count();
        assert!((50..450).contains(&met), "{met}");
    }
}
