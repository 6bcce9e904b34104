//! Rows of pixels nearly all of which see a triangle of their own: each triangle is worked out where its
//! pixel sees it, side by side, with no plane kept.
//!
//! What the rows below need of the mesh is asked for meanwhile.

use super::lanes::Lanes;
use super::maps::{ROWS, Resolver, Sheet};
use super::planes::Pending;
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
            self.ask_triangles(row);
            self.ask_vertices(row);
            self.dot_row(l, row, line);
            (self.put)(line, row);
        }
    }

    #[inline(always)]
    fn ask_triangles(&mut self, row: usize) {
        let triangles = self.place.eye.frame.mesh().triangles();
        let until = SIZE.min(row + TRIANGLES_AHEAD + 1);
        for row in self.resolver.asked[0].max(row)..until {
            for &id in self.tile.row(row, SIZE) {
                prefetch(triangles, if id == NONE { 0 } else { id } as usize);
            }
        }
        self.resolver.asked[0] = until;
    }

    #[inline(always)]
    fn ask_vertices(&mut self, row: usize) {
        let mesh = self.place.eye.frame.mesh();
        let until = SIZE.min(row + VERTICES_AHEAD + 1);
        for row in self.resolver.asked[1].max(row)..until {
            let y = self.y(row);
            let ids = self.tile.row(row, SIZE);
            let Resolver { pending, x, .. } = &mut *self.resolver;
            let pending = &mut pending[SIZE * (row % ROWS)..][..SIZE];
            for ((pending, &id), &x) in pending.iter_mut().zip(ids).zip(&*x) {
                let id = if id == NONE { 0 } else { id };
                let vertices = mesh.triangles()[id as usize];
                for vertex in vertices {
                    prefetch(mesh.vertices(), vertex as usize);
                }
                *pending = Pending {
                    id,
                    spot: [x, y],
                    vertices,
                };
            }
        }
        self.resolver.asked[1] = until;
    }

    #[inline(always)]
    fn dot_row<L: Lanes>(&mut self, l: L, row: usize, line: &mut Line) {
        let frame = &self.place.eye.frame;
        let ids = self.tile.row(row, SIZE);
        let Resolver {
            pending,
            fresh,
            rows,
            ..
        } = &mut *self.resolver;
        if rows[row % ROWS].0 == 1 && ids[0] == NONE {
            return line.clear();
        }
        line.triangles[WORDS..].copy_from_slice(ids);
        fresh.load(l, frame, &pending[SIZE * (row % ROWS)..][..SIZE]);
        fresh.set_up::<false>(self.window);
        let mut doubtful = fresh.write(l, line);
        for (column, _) in ids.iter().enumerate().filter(|(_, id)| **id == NONE) {
            line.blank(column);
            doubtful &= !(1 << column);
        }
        self.settle(doubtful, self.y(row), line);
    }
}
