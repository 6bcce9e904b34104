//! What the samples of a tile see: by rasterising, past cut-out surface by rays.

use super::Visible;
use super::bent::Bent;
use super::clusters::Clusters;
use super::lens::Place;
use super::rays::Probe;
use super::scan::scan;
use super::surface::Frame;
use super::tile::{Spot, Tile};
use glam::DVec3;

/// The tree of a mesh, and the largest distance from its centre.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Scenery<'s> {
    pub(crate) clusters: &'s Clusters,
    pub(crate) radius: f64,
}

/// A tile with the directions in which its samples look.
pub(crate) struct Look<'p> {
    place: Place<'p>,
    tile: Tile,
    /// Where a lens bends rays.
    behind: Behind,
}

/// What bends the rays of a tile.
enum Behind {
    Pinhole,
    Lens(Bent),
    /// A lens that bends no ray to any sample.
    Nothing,
}

impl<'p> Look<'p> {
    /// Looks from `place` at `width` × `height` samples.
    pub(crate) fn new(
        scenery: Scenery<'_>,
        place: Place<'p>,
        (width, height): (usize, usize),
    ) -> Self {
        let behind = match place.eye.is_bent() {
            false => Behind::Pinhole,
            true => Bent::new(&place, (width, height)).map_or(Behind::Nothing, Behind::Lens),
        };
        let tile = match &behind {
            Behind::Pinhole => scan(scenery.clusters, (&place, None), (width, height)),
            Behind::Lens(bent) => draw_bent(scenery, (&place, bent), (width, height)),
            Behind::Nothing => Tile::new(width, height),
        };
        let mut look = Self {
            place,
            tile,
            behind,
        };
        if place.eye.frame.has_cutouts() {
            look.pass_cutouts(scenery, (width, height));
        }
        look
    }

    /// Looks again where the nearest triangle is cut out.
    fn pass_cutouts(&mut self, scenery: Scenery<'_>, (width, height): (usize, usize)) {
        let frame = &self.place.eye.frame;
        for spot in spots(width, height) {
            let direction = self.direction(spot);
            let cut = self.tile.triangle(spot).is_some_and(|triangle| {
                let crossing = frame.cross(triangle as usize, direction);
                crossing.is_some_and(|c| !frame.is_solid(triangle as usize, c.weights))
            });
            if cut {
                self.tile.put(spot, trace(scenery, frame, direction));
            }
        }
    }

    /// What is visible at all samples.
    pub(crate) fn tile(&self) -> &Tile {
        &self.tile
    }

    /// The visible triangle at a sample.
    pub(crate) fn triangle(&self, spot: Spot) -> Option<u32> {
        self.tile.triangle(spot)
    }

    /// About 1 / z-depth of what a sample sees.
    pub(crate) fn nearness(&self, spot: Spot) -> f32 {
        self.tile.nearness(spot)
    }

    /// The direction of a sample in the camera frame at depth 1; NaN where the lens has none.
    pub(crate) fn direction(&self, spot: Spot) -> DVec3 {
        match &self.behind {
            Behind::Pinhole => {
                let place = &self.place;
                place
                    .eye
                    .direction(place.column + spot.column, place.row + spot.row)
            }
            Behind::Lens(bent) => bent.directions[spot.index()],
            Behind::Nothing => DVec3::NAN,
        }
    }

    /// The visible triangles of a row's samples, [`super::tile::NONE`] where there is none and beyond the
    /// used part.
    #[inline(always)]
    pub(crate) fn row(&self, row: usize) -> &[u32] {
        self.tile.row(Spot { column: 0, row })
    }

    /// Whether the directions of a row's samples differ from another row's in y alone.
    pub(crate) fn is_straight(&self) -> bool {
        matches!(self.behind, Behind::Pinhole)
    }

    /// Whether no sample sees anything and each of them has a ray.
    pub(crate) fn is_blank(&self, (width, height): (usize, usize)) -> bool {
        self.tile.is_blank() && spots(width, height).all(|spot| self.has_ray(spot))
    }

    /// How many samples see something.
    pub(crate) fn count(&self) -> usize {
        self.tile.count()
    }

    /// Whether a ray belongs to a sample.
    pub(crate) fn has_ray(&self, spot: Spot) -> bool {
        match &self.behind {
            Behind::Pinhole => true,
            Behind::Lens(bent) => bent.has_ray(spot.index()),
            Behind::Nothing => false,
        }
    }
}

/// Samples may lie this far from the whole numbers of their grid.
const MOST_AWAY: f32 = 8.0;
/// Samples a side that are not cut into less.
const FEW: usize = 16;

/// Draws a tile behind a lens. Near 90° from the axis the plane at depth 1 has no end: a grid that reaches
/// there is so coarse that the other samples share a few of its cells, and each triangle would be tested at
/// nearly all of them. Such a tile is drawn in quarters, each on a grid of its own; where even few samples
/// lie so unevenly, their rays are traced.
fn draw_bent(
    scenery: Scenery<'_>,
    (place, bent): (&Place<'_>, &Bent),
    (width, height): (usize, usize),
) -> Tile {
    if bent.away <= MOST_AWAY {
        return scan(scenery.clusters, (place, Some(bent)), (width, height));
    }
    let mut whole = Tile::new(width, height);
    if width.max(height) <= FEW {
        for spot in spots(width, height).filter(|spot| bent.has_ray(spot.index())) {
            let direction = bent.directions[spot.index()];
            whole.put(spot, trace(scenery, &place.eye.frame, direction));
        }
        return whole;
    }
    let [across, down] = [width, height].map(|side| match side <= FEW {
        true => side,
        false => side.div_ceil(2),
    });
    for row in (0..height).step_by(down) {
        for column in (0..width).step_by(across) {
            let part = Place {
                column: place.column + column,
                row: place.row + row,
                ..*place
            };
            let first = Spot { column, row };
            let size = (across.min(width - column), down.min(height - row));
            if let Some(bent) = bent.part(place.eye.focal, first, size) {
                let drawn = draw_bent(scenery, (&part, &bent), size);
                whole.put_part(first, &drawn, size);
            }
        }
    }
    whole
}

/// All samples of a tile, row by row.
pub(crate) fn spots(width: usize, height: usize) -> impl Iterator<Item = Spot> {
    (0..width * height).map(move |index| Spot {
        column: index % width,
        row: index / width,
    })
}

/// What is visible along one direction of the camera frame, with z = 1.
fn trace(scenery: Scenery<'_>, frame: &Frame<'_>, direction: DVec3) -> Option<Visible> {
    let probe = Probe::new(frame.eye(), frame.to_world(direction));
    let cross = |triangle| {
        let crossing = frame.cross(triangle, direction);
        crossing.filter(|crossing| frame.is_solid(triangle, crossing.weights))
    };
    probe.nearest(scenery.clusters, (scenery.radius, f64::INFINITY), cross)
}

#[cfg(test)]
mod tests {
    use super::super::Renderer;
    use super::super::eye::Eye;
    use super::super::tile::SIZE;
    use super::super::widths::shapes::{soup, terrain};
    use super::*;
    use glam::DVec2;
    use mvs_datasets::scene::{Camera, Distortion, Pose, View};

    /// From amid the mesh through a fisheye whose rim, 90° from the axis, is 63 pixels from the centre.
    fn wide() -> View {
        let camera = Camera::new(150, 130, DVec2::splat(40.0), DVec2::new(74.6, 65.2));
        let camera = camera.unwrap().with_distortion(Distortion::Fisheye {
            radial: [1e-3, 0.0, 0.0, 0.0],
        });
        let eye = DVec3::new(0.1, -0.2, 0.3);
        View {
            id: 0,
            name: String::new(),
            camera: camera.unwrap(),
            pose: Pose::looking_at(eye, DVec3::new(0.4, 0.3, 0.1), DVec3::Z).unwrap(),
            depth_range: None,
        }
    }

    #[test]
    fn tiles_near_the_rim_are_drawn_in_parts_that_see_what_the_whole_sees() {
        let (mut cut, mut seen) = (0, 0);
        for mesh in [terrain(60), soup(2000, 4)] {
            let renderer = Renderer::new(&mesh).unwrap();
            let (scenery, view) = (renderer.scenery(), wide());
            let eye = Eye::new(Frame::new(&mesh, renderer.center, &view), 1);
            for (column, row) in (0..9).map(|tile| (tile % 3 * SIZE, tile / 3 * SIZE)) {
                let size = (SIZE.min(150 - column), SIZE.min(130 - row));
                let place = Place {
                    eye: &eye,
                    column,
                    row,
                };
                let Some(bent) = Bent::new(&place, size) else {
                    continue;
                };
                let parts = draw_bent(scenery, (&place, &bent), size);
                let whole = scan(scenery.clusters, (&place, Some(&bent)), size);
                for spot in spots(size.0, size.1) {
                    assert_eq!(parts.triangle(spot), whole.triangle(spot), "{spot:?}");
                }
                cut += usize::from(bent.away > MOST_AWAY);
                seen += whole.count();
            }
        }
        assert!(cut >= 8 && seen > 5000, "{cut} {seen}");
    }
}
