//! Rows of tiles put into the maps of a view: past the caches, whole cache lines at a time. What is left of
//! a line at the end of a tile's row waits for the tile to its right.

use super::Seen;
use super::row::Line;
use super::tile::SIZE;
use crate::ahead::{WORDS, Word, past_border, stream};

/// Some rows of all maps, pixel by pixel.
pub(super) struct Maps<'s> {
    triangles: &'s mut [u32],
    depth: &'s mut [f32],
    normals: &'s mut [f32],
    weights: &'s mut [f32],
}

impl<'s> Maps<'s> {
    pub(super) fn of(seen: &'s mut Seen) -> Self {
        Self {
            triangles: &mut seen.triangles,
            depth: &mut seen.depth,
            normals: seen.normals.as_flattened_mut(),
            weights: seen.weights.as_flattened_mut(),
        }
    }

    /// Bands of `size` pixels.
    pub(super) fn cut(self, size: usize) -> Vec<Self> {
        let triangles = self.triangles.chunks_mut(size);
        let depth = self.depth.chunks_mut(size);
        let normals = self.normals.chunks_mut(3 * size);
        let weights = self.weights.chunks_mut(2 * size);
        let all = triangles.zip(depth).zip(normals.zip(weights));
        all.map(|((triangles, depth), (normals, weights))| Self {
            triangles,
            depth,
            normals,
            weights,
        })
        .collect()
    }

    /// Writes `count` pixels from place `first` on.
    #[inline(always)]
    pub(super) fn put(&mut self, line: &Line, first: usize, count: usize) {
        copy(self.triangles, (first, count), &line.triangles);
        copy(self.depth, (first, count), &line.depth);
        copy(self.weights, (2 * first, 2 * count), &line.weights);
        copy(self.normals, (3 * first, 3 * count), &line.normals);
    }

    /// As [`Self::put`] for a row of a tile, past the caches.
    #[inline(always)]
    pub(super) fn stream(&mut self, line: &mut Line, row: &Row, waiting: &mut Waiting) {
        let Waiting {
            triangles,
            depth,
            normals,
            weights,
        } = waiting;
        send(self.triangles, &mut line.triangles, (row, 1), triangles);
        send(self.depth, &mut line.depth, (row, 1), depth);
        send(self.weights, &mut line.weights, (row, 2), weights);
        send(self.normals, &mut line.normals, (row, 3), normals);
    }
}

/// A tile's row in a band.
#[derive(Debug, Clone, Copy)]
pub(super) struct Row {
    /// Its number in the tile.
    pub(super) number: usize,
    /// The place of its first pixel, and how many there are.
    pub(super) first: usize,
    pub(super) count: usize,
    /// Whether another tile lies to the left, and to the right.
    pub(super) joined: [bool; 2],
}

/// The last words of each row, map by map.
pub(super) struct Waiting {
    triangles: [[u32; WORDS]; SIZE],
    depth: [[f32; WORDS]; SIZE],
    normals: [[f32; WORDS]; SIZE],
    weights: [[f32; WORDS]; SIZE],
}

impl Waiting {
    pub(super) const NONE: Self = Self {
        triangles: [[0; WORDS]; SIZE],
        depth: [[0.0; WORDS]; SIZE],
        normals: [[0.0; WORDS]; SIZE],
        weights: [[0.0; WORDS]; SIZE],
    };
}

#[inline(always)]
fn copy<T: Word>(map: &mut [T], (first, count): (usize, usize), line: &[T]) {
    map[first..][..count].copy_from_slice(&line[WORDS..][..count]);
}

/// Writes a row of a map with `words` to a pixel.
#[inline(always)]
fn send<T: Word>(
    map: &mut [T],
    line: &mut [T],
    (row, words): (&Row, usize),
    waiting: &mut [[T; WORDS]; SIZE],
) {
    let (first, count) = (words * row.first, words * row.count);
    let waiting = &mut waiting[row.number % SIZE];
    let past = past_border(map, first);
    let [joined_left, joined_right] = row.joined;
    let (mut from, mut to) = (WORDS - past, first.wrapping_sub(past));
    if joined_left {
        line[..WORDS].copy_from_slice(waiting);
    } else if past > 0 {
        let head = (WORDS - past).min(count);
        map[first..][..head].copy_from_slice(&line[WORDS..][..head]);
        (from, to) = (WORDS + head, first + head);
    }
    let left = first + count - to;
    let whole = left - left % WORDS;
    stream(&line[from..][..whole], &mut map[to..][..whole]);
    if joined_right {
        waiting.copy_from_slice(&line[count..][..WORDS]);
    } else {
        map[to + whole..first + count].copy_from_slice(&line[from + whole..WORDS + count]);
    }
}
