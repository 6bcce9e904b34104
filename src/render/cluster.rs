//! A cluster of triangles as it lies in memory: one run of words, so that reading it is one stream.
//!
//! Head: the centre (three f64), the radius, the counts of packs and triangles. Then the vertices,
//! eight side by side per axis; then the triangles in groups of eight: which vertices their corners
//! are, a byte each, and their numbers in the mesh. Words that are no f32 are kept as bits of one.

use super::lanes::LANES;
use glam::DVec3;

/// Most triangles of a cluster: its vertices are numbered in a byte.
pub(crate) const MOST_TRIANGLES: usize = 80;
/// Most vertices of a cluster.
pub(crate) const MOST_VERTICES: usize = 3 * MOST_TRIANGLES;

const HEAD: usize = 8;
/// Eight vertices: their x, their y, their z.
pub(crate) type Pack = [f32; 3 * LANES];
const CORNER_WORDS: usize = 2;
/// Eight triangles: their first, second and third corners, then their numbers.
type Group = [f32; 3 * CORNER_WORDS + LANES];

/// A cluster, read where it lies.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Cluster<'c> {
    /// What its vertices are counted from, itself counted from the mesh's centre.
    pub(crate) center: DVec3,
    /// The largest coordinate of its vertices, in absolute value.
    pub(crate) radius: f32,
    /// Offsets of the vertices from the centre; the last pack is filled up with copies.
    pub(crate) packs: &'c [Pack],
    groups: &'c [Group],
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
        let groups = &rest[..triangles.div_ceil(LANES) * size_of::<Group>() / 4];
        Self {
            center: DVec3::new(
                f64::from_bits(pair(0)),
                f64::from_bits(pair(2)),
                f64::from_bits(pair(4)),
            ),
            radius: head[6],
            packs: vertices.as_chunks().0,
            groups: groups.as_chunks().0,
            triangles,
        }
    }

    /// How many triangles it has.
    #[inline(always)]
    pub(crate) fn count(&self) -> usize {
        self.triangles
    }

    /// Its triangles, eight at a time.
    #[inline(always)]
    pub(crate) fn groups(&self) -> impl Iterator<Item = Eight> {
        let count = self.triangles;
        let used = move |first: usize| LANES.min(count - first * LANES);
        self.groups
            .iter()
            .enumerate()
            .map(move |(index, group)| Eight::read(group, used(index)))
    }

    /// All triangles: the vertices of their corners, their numbers in the mesh.
    pub(crate) fn triangles(&self) -> impl Iterator<Item = ([usize; 3], u32)> {
        self.groups().flat_map(|eight| {
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
    #[inline(always)]
    fn read(group: &Group, used: usize) -> Self {
        let mut places = [[0; LANES]; 3];
        for corner in 0..3 {
            let [low, high] = [
                group[CORNER_WORDS * corner],
                group[CORNER_WORDS * corner + 1],
            ];
            let word = u64::from(low.to_bits()) | u64::from(high.to_bits()) << 32;
            places[corner] = word.to_le_bytes();
        }
        let mut numbers = [0.0; LANES];
        numbers.copy_from_slice(&group[3 * CORNER_WORDS..]);
        Self {
            places,
            numbers,
            used,
        }
    }

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
    groups: Vec<Group>,
    vertices: usize,
    triangles: usize,
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
        let lane = self.triangles % LANES;
        if lane == 0 {
            self.groups.push([0.0; 3 * CORNER_WORDS + LANES]);
        }
        if let Some(group) = self.groups.last_mut() {
            for (corner, place) in corners.into_iter().enumerate() {
                let word = &mut group[CORNER_WORDS * corner + lane / 4];
                *word = f32::from_bits(word.to_bits() | u32::from(place) << (lane % 4 * 8));
            }
            group[3 * CORNER_WORDS + lane] = f32::from_bits(number);
        }
        self.triangles += 1;
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
            self.packs.len() as u32 | (self.triangles as u32) << 16,
        ));
        words.extend(self.packs.as_flattened());
        words.extend(self.groups.as_flattened());
        self.packs.clear();
        self.groups.clear();
        (self.vertices, self.triangles, self.radius) = (0, 0, 0.0);
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
