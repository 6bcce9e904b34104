//! Rows of tiles put into the maps of a view: past the caches, whole cache lines at a time. What is left of
//! a line at the end of a tile's row waits for the tile to its right.

use super::Seen;
use super::row::Line;
use super::tile::SIDE;
use crate::ahead::{Stream, WORDS, Word, past_border};

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
            stream,
        } = waiting;
        send(
            stream,
            (self.triangles, &mut line.triangles),
            (row, 1),
            triangles,
        );
        send(stream, (self.depth, &mut line.depth), (row, 1), depth);
        send(stream, (self.weights, &mut line.weights), (row, 2), weights);
        send(stream, (self.normals, &mut line.normals), (row, 3), normals);
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

/// The last words of each row, map by map, and what writes them.
pub(super) struct Waiting {
    stream: Stream,
    triangles: [[u32; WORDS]; SIDE],
    depth: [[f32; WORDS]; SIDE],
    normals: [[f32; WORDS]; SIDE],
    weights: [[f32; WORDS]; SIDE],
}

impl Waiting {
    pub(super) fn new() -> Self {
        Self {
            stream: Stream::new(),
            triangles: [[0; WORDS]; SIDE],
            depth: [[0.0; WORDS]; SIDE],
            normals: [[0.0; WORDS]; SIDE],
            weights: [[0.0; WORDS]; SIDE],
        }
    }
}

#[inline(always)]
fn copy<T: Word>(map: &mut [T], (first, count): (usize, usize), line: &[T]) {
    map[first..][..count].copy_from_slice(&line[WORDS..][..count]);
}

/// Writes a row of a map with `words` to a pixel.
#[inline(always)]
fn send<T: Word>(
    stream: &Stream,
    (map, line): (&mut [T], &mut [T]),
    (row, words): (&Row, usize),
    waiting: &mut [[T; WORDS]; SIDE],
) {
    let (first, count) = (words * row.first, words * row.count);
    let waiting = &mut waiting[row.number % SIDE];
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
    stream.copy(&line[from..][..whole], &mut map[to..][..whole]);
    if joined_right {
        waiting.copy_from_slice(&line[count..][..WORDS]);
    } else {
        map[to + whole..first + count].copy_from_slice(&line[from + whole..WORDS + count]);
    }
}

#[cfg(test)]
mod tests {
    use super::super::tile::SIZE;
    use super::*;

    /// Rows of numbered words, sent tile by tile to a map that begins `shift` words after some place.
    fn sent((width, rows): (usize, usize), words: usize, shift: usize) -> Vec<u32> {
        let mut memory = vec![u32::MAX; shift + words * width * rows];
        let map = &mut memory[shift..];
        let mut waiting = [[0; WORDS]; SIDE];
        let stream = Stream::new();
        for column in (0..width).step_by(SIZE) {
            for number in 0..rows {
                let (first, count) = (number * width + column, SIZE.min(width - column));
                let row = Row {
                    number,
                    first,
                    count,
                    joined: [column > 0, column + count < width],
                };
                let mut line = vec![7; 2 * WORDS + words * SIZE];
                for (word, place) in line[WORDS..].iter_mut().zip(0..words * count) {
                    *word = u32::try_from(words * first + place).unwrap();
                }
                send(&stream, (&mut *map, &mut line), (&row, words), &mut waiting);
            }
        }
        drop(stream);
        memory.split_off(shift)
    }

    #[test]
    fn every_word_arrives_wherever_cache_lines_begin() {
        for width in [1, 3, 15, 16, 17, 63, 64, 65, 100, 128, 200] {
            for words in 1..=3 {
                for shift in 0..WORDS {
                    let expected: Vec<u32> = (0..).take(words * width * 5).collect();
                    let found = sent((width, 5), words, shift);
                    assert!(found == expected, "{width} wide, {words} words, {shift}");
                }
            }
        }
    }
}
