//! Rows of pixels nearly all of which see a triangle of their own: each triangle is worked out where its
//! pixel sees it, side by side, with no plane kept.
//!
//! What the rows below need of the mesh is asked for meanwhile.

use super::lanes::{LANES, Lanes};
use super::maps::{ROWS, Resolver, Sheet};
use super::row::Line;
use super::tile::{NONE, SIZE};
use crate::ahead::{WORDS, prefetch};

/// How many rows ahead triangles, and vertices, are asked for.
const TRIANGLES_AHEAD: usize = 6;
const VERTICES_AHEAD: usize = 2;
const _: () = assert!(VERTICES_AHEAD < ROWS);

impl<P: FnMut(&mut Line, usize)> Sheet<'_, P> {
    /// Works out some rows pixel by pixel, having asked for what the rows below need.
    #[inline(always)]
    pub(super) fn dot<L: Lanes>(&mut self, l: L, (top, count): (usize, usize), line: &mut Line) {
        for row in top..top + count {
            self.ask_before(row);
            self.dot_row(l, row, line);
            (self.put)(line, row);
        }
    }

    /// Asks for what rows above have not asked for.
    #[inline(always)]
    fn ask_before(&mut self, row: usize) {
        let [triangles, vertices] = self.resolver.asked;
        let (_, rows) = self.part.size;
        for row in triangles.max(row)..rows.min(row + TRIANGLES_AHEAD) {
            for first in (0..SIZE).step_by(LANES) {
                self.ask_triangles((row, first));
            }
        }
        for row in vertices.max(row)..rows.min(row + VERTICES_AHEAD) {
            for first in (0..SIZE).step_by(LANES) {
                self.ask_vertices((row, first));
            }
        }
        self.resolver.asked = [TRIANGLES_AHEAD, VERTICES_AHEAD].map(|ahead| row + ahead + 1);
    }

    /// Asks for the triangles that some pixels of a row see.
    #[inline(always)]
    fn ask_triangles(&self, (row, first): (usize, usize)) {
        let triangles = self.place.eye.frame.mesh().triangles();
        for &id in &self.ids(row)[first..][..LANES] {
            prefetch(triangles, if id == NONE { 0 } else { id } as usize);
        }
    }

    /// Asks for their vertices.
    #[inline(always)]
    fn ask_vertices(&mut self, (row, first): (usize, usize)) {
        let mesh = self.place.eye.frame.mesh();
        let (triangles, positions) = (mesh.triangles(), mesh.vertices());
        let ids = &self.ids(row)[first..][..LANES];
        let seen = &mut self.resolver.vertices[SIZE * (row % ROWS) + first..][..LANES];
        for (vertices, &id) in seen.iter_mut().zip(ids) {
            *vertices = triangles[if id == NONE { 0 } else { id } as usize];
            for &vertex in &*vertices {
                prefetch(positions, vertex as usize);
            }
        }
    }

    /// Works out a row, and asks by the way for what is needed later: so neither waits for the other.
    #[inline(always)]
    fn dot_row<L: Lanes>(&mut self, l: L, row: usize, line: &mut Line) {
        let (_, rows) = self.part.size;
        let (frame, y) = (&self.place.eye.frame, self.y(row));
        self.resolver.fresh.spots = [self.resolver.x, [y; SIZE]];
        for first in (0..SIZE).step_by(LANES) {
            if row + TRIANGLES_AHEAD < rows {
                self.ask_triangles((row + TRIANGLES_AHEAD, first));
            }
            if row + VERTICES_AHEAD < rows {
                self.ask_vertices((row + VERTICES_AHEAD, first));
            }
            let Resolver {
                vertices, fresh, ..
            } = &mut *self.resolver;
            let vertices = &vertices[SIZE * (row % ROWS)..][..SIZE];
            fresh.load_corners(l, frame, (first, first + LANES), |index| vertices[index]);
            // What was stored by halves is not read as a whole at once.
            if let Some(before) = first.checked_sub(LANES) {
                fresh.see(self.window.reach, (before, first));
            }
        }
        let ids = self.ids(row);
        let fresh = &mut self.resolver.fresh;
        fresh.see(self.window.reach, (SIZE - LANES, SIZE));
        line.triangles[WORDS..].copy_from_slice(ids);
        let doubtful = fresh.write(l, line);
        let mut seen = 0;
        for (index, eight) in ids.as_chunks().0.iter().enumerate() {
            seen |= u64::from(l.differ(eight, &[NONE; LANES])) << (LANES * index);
        }
        let mut blank = !seen;
        while blank != 0 {
            line.blank(blank.trailing_zeros() as usize % SIZE);
            blank &= blank - 1;
        }
        self.settle(doubtful & seen, y, line);
    }
}
