//! What the samples of a tile see: by rasterising, past cut-out surface by rays.

use super::Visible;
use super::bent::Bent;
use super::clusters::Clusters;
use super::lens::Place;
use super::rays::Probe;
use super::scan::scan;
use super::surface::Frame;
use super::tile::{SIZE, Spot, Tile};
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
            Behind::Lens(bent) => scan(scenery.clusters, (&place, Some(bent)), (width, height)),
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
        self.tile.row(row, SIZE)
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
