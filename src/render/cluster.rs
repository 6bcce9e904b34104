//! A cluster of triangles as it lies in memory: one run of words, so that reading it is one stream.
//!
//! Head: the centre (three f64), the radius, the counts of packs and triangles. Then the vertices,
//! eight side by side per axis; then the triangles, filled up to groups of eight: which vertices their
//! first corners are, a byte each, their second, their third, and their numbers in the mesh. Words that
//! are no f32 are kept as bits of one.

use super::lanes::LANES;
use glam::DVec3;

/// Most triangles of a cluster: its vertices are numbered in a byte.
pub(crate) const MOST_TRIANGLES: usize = 80;
/// Most vertices of a cluster.
pub(crate) const MOST_VERTICES: usize = 3 * MOST_TRIANGLES;

const HEAD: usize = 8;
/// Eight vertices: their x, their y, their z.
pub(crate) type Pack = [f32; 3 * LANES];
/// Words of eight triangles: of one of their corners, and in all.
const CORNER_WORDS: usize = 2;
const GROUP_WORDS: usize = 3 * CORNER_WORDS + LANES;
/// Triangles whose corners are looked at together.
pub(crate) const MANY: usize = 32;
/// One corner of each of them, a byte each.
pub(crate) type Many = [f32; MANY / 4];

/// A cluster, read where it lies.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Cluster<'c> {
    /// What its vertices are counted from, itself counted from the mesh's centre.
    pub(crate) center: DVec3,
    /// The largest coordinate of its vertices, in absolute value.
    pub(crate) radius: f32,
    /// Offsets of the vertices from the centre; the last pack is filled up with copies.
    pub(crate) packs: &'c [Pack],
    /// Words of the triangles.
    rest: &'c [f32],
    triangles: usize,
}

impl<'c> Cluster<'c> {
    /// The cluster whose words start with `words`.
    #[inline(always)]
    pub(crate) fn read(words: &'c [f32]) -> Self {
        let (head, rest) = words.split_at(HEAD);
        let pair =
            |at: usize| u64::from(head[at].to_bits()) | u64::from(head[at + 1].to_bits()) << 32;
        let counts = head[7].to_bits();
        let (packs, triangles) = ((counts & 0xffff) as usize, (counts >> 16) as usize);
        let (vertices, rest) = rest.split_at(packs * size_of::<Pack>() / 4);
        let rest = &rest[..triangles.div_ceil(LANES) * GROUP_WORDS];
        Self {
            center: DVec3::new(
                f64::from_bits(pair(0)),
                f64::from_bits(pair(2)),
                f64::from_bits(pair(4)),
            ),
            radius: head[6],
            packs: vertices.as_chunks().0,
            rest,
            triangles,
        }
    }

    /// How many triangles it has.
    #[inline(always)]
    pub(crate) fn count(&self) -> usize {
        self.triangles
    }

    /// How many groups of eight it has, the last of which may be filled up.
    #[inline(always)]
    pub(crate) fn groups(&self) -> usize {
        self.triangles.div_ceil(LANES)
    }

    /// Eight of its triangles.
    #[inline(always)]
    pub(crate) fn eight(&self, group: usize) -> Eight {
        let count = self.groups();
        let (corners, numbers) = self.rest.split_at(3 * CORNER_WORDS * count);
        let mut places = [[0; LANES]; 3];
        for (corner, places) in places.iter_mut().enumerate() {
            let from = CORNER_WORDS * (corner * count + group);
            let [low, high] = [corners[from], corners[from + 1]];
            let word = u64::from(low.to_bits()) | u64::from(high.to_bits()) << 32;
            *places = word.to_le_bytes();
        }
        let mut eight = Eight {
            places,
            numbers: [0.0; LANES],
            used: LANES.min(self.triangles - LANES * group),
        };
        eight
            .numbers
            .copy_from_slice(&numbers[LANES * group..][..LANES]);
        eight
    }

    /// Corners of many of its triangles from a group on; anything beyond the last.
    #[inline(always)]
    pub(crate) fn many(&self, group: usize) -> [&'c Many; 3] {
        let count = self.groups();
        let from = |corner: usize| CORNER_WORDS * (corner * count + group);
        let corner = |corner: usize| self.rest.get(from(corner)..)?.first_chunk();
        const NONE: &Many = &[0.0; MANY / 4];
        [0, 1, 2].map(|k| corner(k).unwrap_or(NONE))
    }

    /// All triangles: the vertices of their corners, their numbers in the mesh.
    pub(crate) fn triangles(&self) -> impl Iterator<Item = ([usize; 3], u32)> {
        let eights = (0..self.groups()).map(|group| self.eight(group));
        eights.flat_map(|eight| {
            (0..eight.used).map(move |lane| {
                let corners = [0, 1, 2].map(|corner| usize::from(eight.places[corner][lane]));
                (corners, eight.number(lane))
            })
        })
    }
}

/// Eight triangles of a cluster.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Eight {
    /// Which vertices of the cluster their corners are; the first where there is none.
    pub(crate) places: [[u8; LANES]; 3],
    /// Their numbers in the mesh, as bits.
    pub(crate) numbers: [f32; LANES],
    /// How many there are.
    pub(crate) used: usize,
}

impl Eight {
    /// The number of a triangle in the mesh.
    #[inline(always)]
    pub(crate) fn number(&self, lane: usize) -> u32 {
        self.numbers[lane % LANES].to_bits()
    }
}

/// A cluster in the making.
#[derive(Debug, Default)]
pub(crate) struct Draft {
    packs: Vec<Pack>,
    corners: [Vec<u8>; 3],
    numbers: Vec<u32>,
    vertices: usize,
    radius: f32,
}

impl Draft {
    /// Adds a vertex at an offset from the centre and returns its place.
    pub(crate) fn add_vertex(&mut self, offset: [f32; 3]) -> u8 {
        let lane = self.vertices % LANES;
        if lane == 0 {
            self.packs.push([0.0; 3 * LANES]);
        }
        if let Some(pack) = self.packs.last_mut() {
            for (axis, value) in offset.into_iter().enumerate() {
                pack[axis * LANES + lane..(axis + 1) * LANES].fill(value);
            }
        }
        self.radius = offset
            .iter()
            .fold(self.radius, |radius, v| radius.max(v.abs()));
        self.vertices += 1;
        #[allow(clippy::cast_possible_truncation, reason = "at most 240 vertices")]
        let place = (self.vertices - 1) as u8;
        place
    }

    /// Adds a triangle: the places of its corners, its number in the mesh.
    pub(crate) fn add_triangle(&mut self, corners: [u8; 3], number: u32) {
        for (places, place) in self.corners.iter_mut().zip(corners) {
            places.push(place);
        }
        self.numbers.push(number);
    }

    /// Appends the cluster to `words`; the draft is empty then.
    pub(crate) fn write(&mut self, center: DVec3, words: &mut Vec<f32>) {
        for value in center.to_array() {
            let [low, high] = [value.to_bits() & 0xffff_ffff, value.to_bits() >> 32];
            #[allow(clippy::cast_possible_truncation, reason = "half of the bits each")]
            words.extend([low, high].map(|half| f32::from_bits(half as u32)));
        }
        words.push(self.radius);
        #[allow(clippy::cast_possible_truncation, reason = "at most 30 and 80")]
        words.push(f32::from_bits(
            self.packs.len() as u32 | (self.numbers.len() as u32) << 16,
        ));
        words.extend(self.packs.as_flattened());
        let filled = self.numbers.len().next_multiple_of(LANES);
        for places in &mut self.corners {
            places.resize(filled, 0);
            let (four, _) = places.as_chunks();
            words.extend(
                four.iter()
                    .map(|&four| f32::from_bits(u32::from_le_bytes(four))),
            );
            places.clear();
        }
        self.numbers.resize(filled, 0);
        words.extend(self.numbers.iter().map(|&number| f32::from_bits(number)));
        self.numbers.clear();
        self.packs.clear();
        (self.vertices, self.radius) = (0, 0.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_written_is_read_back() {
        let mut words = Vec::new();
        let mut draft = Draft::default();
        let mut firsts = Vec::new();
        for count in [1u8, 8, 9, 64] {
            for vertex in 0..count {
                assert_eq!(draft.add_vertex([f32::from(vertex), -300.0, 2.0]), vertex);
            }
            for triangle in 0..count {
                draft.add_triangle(
                    [triangle, count - 1, triangle / 2],
                    u32::MAX - u32::from(triangle),
                );
            }
            firsts.push(words.len());
            draft.write(DVec3::new(1e7 + 0.1, -0.3, f64::from(count)), &mut words);
        }
        for (count, first) in [1u8, 8, 9, 64].into_iter().zip(firsts) {
            let cluster = Cluster::read(&words[first..]);
            assert_eq!(
                cluster.center,
                DVec3::new(1e7 + 0.1, -0.3, f64::from(count))
            );
            assert_eq!(
                (cluster.radius, cluster.packs.len()),
                (300.0, usize::from(count).div_ceil(8))
            );
            let last = cluster.packs[cluster.packs.len() - 1];
            assert_eq!(
                (last[7], last[15], last[23]),
                (f32::from(count - 1), -300.0, 2.0)
            );
            let triangles: Vec<_> = cluster.triangles().collect();
            let expected: Vec<_> = (0..count)
                .map(|t| {
                    (
                        [t, count - 1, t / 2].map(usize::from),
                        u32::MAX - u32::from(t),
                    )
                })
                .collect();
            assert_eq!(triangles, expected);
        }
    }
}
