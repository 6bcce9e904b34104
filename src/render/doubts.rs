//! What f32 cannot decide, put off until a tile is drawn: much of it is hidden by then, and the triangles of
//! the rest are fetched together.

use super::surface::Frame;
use crate::ahead::prefetch;

/// Most that wait.
const MOST: usize = 256;

/// A triangle that may be what a sample sees.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Doubt {
    /// Where the sample stands in the columns of the tile.
    pub(crate) index: usize,
    pub(crate) triangle: u32,
    /// About its nearness there; off, where not `met`, by less than the bar that doubts are held to.
    pub(crate) nearness: f32,
    /// Whether the sample surely sees it, if nothing nearer, and `nearness` is what it is.
    pub(crate) met: bool,
}

/// Those that wait.
#[derive(Debug, Default)]
pub(crate) struct Doubts {
    waiting: Vec<Doubt>,
}

impl Doubts {
    /// Adds one; `true` where there is no room for another.
    #[cold]
    #[inline(never)]
    pub(crate) fn put(&mut self, doubt: Doubt) -> bool {
        self.waiting.push(doubt);
        self.waiting.len() >= MOST
    }

    /// Takes those that are not `hidden`; their corners are asked for, now that most are known to be hidden: what
    /// is asked for from all over a mesh costs a walk through the tables of pages.
    pub(crate) fn take(
        &mut self,
        frame: &Frame<'_>,
        hidden: impl Fn(&Doubt) -> bool,
    ) -> Vec<Doubt> {
        let mesh = frame.mesh();
        let mut taken = std::mem::take(&mut self.waiting);
        taken.retain(|doubt| !hidden(doubt));
        for doubt in &taken {
            prefetch(mesh.triangles(), doubt.triangle as usize);
        }
        for doubt in &taken {
            for vertex in mesh.triangles()[doubt.triangle as usize] {
                prefetch(mesh.vertices(), vertex as usize);
            }
        }
        taken
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DVec2, DVec3};
    use mvs_datasets::scene::{Camera, Mesh, Pose, View};

    #[test]
    fn what_is_hidden_by_then_is_dropped_and_all_else_is_kept_in_order() {
        let mesh = Mesh::new(vec![DVec3::X, DVec3::Y, DVec3::Z], vec![[0, 1, 2]; 400]).unwrap();
        let view = View {
            id: 0,
            name: String::new(),
            camera: Camera::new(8, 8, DVec2::ONE, DVec2::splat(4.0)).unwrap(),
            pose: Pose::looking_at(DVec3::splat(3.0), DVec3::ZERO, DVec3::Z).unwrap(),
            depth_range: None,
        };
        let frame = Frame::new(&mesh, DVec3::ZERO, &view);
        let mut doubts = Doubts::default();
        let doubt = |triangle: u32| Doubt {
            index: triangle as usize % 7,
            triangle,
            nearness: 1.0,
            met: false,
        };
        for triangle in 0..256 {
            assert_eq!(doubts.put(doubt(triangle)), triangle == 255);
        }
        let taken = doubts.take(&frame, |doubt| doubt.index == 3);
        let left: Vec<u32> = taken.iter().map(|doubt| doubt.triangle).collect();
        let expected: Vec<u32> = (0..256).filter(|triangle| triangle % 7 != 3).collect();
        assert_eq!(left, expected);
        assert!(!doubts.put(doubt(1)) && doubts.take(&frame, |_| false).len() == 1);
    }
}
