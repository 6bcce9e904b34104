//! What the samples of a tile see: through a pinhole by rasterising, through a lens and past cut-out
//! surface by rays.

use super::Visible;
use super::clusters::Clusters;
use super::lens::Place;
use super::rays::Probe;
use super::scan::scan;
use super::surface::Frame;
use super::tile::{SIZE, STRIDE, Spot, Tile};
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
    /// Behind a lens: the direction of each sample, NaN where no ray is bent to it.
    bent: Vec<DVec3>,
}

impl<'p> Look<'p> {
    /// Looks from `place` at `width` × `height` samples.
    pub(crate) fn new(
        scenery: Scenery<'_>,
        place: Place<'p>,
        (width, height): (usize, usize),
    ) -> Self {
        if place.eye.is_bent() {
            return Self::through_lens(scenery, place, (width, height));
        }
        let tile = scan(scenery.clusters, &place, (width, height));
        let mut look = Self {
            place,
            tile,
            bent: Vec::new(),
        };
        if place.eye.frame.has_cutouts() {
            look.pass_cutouts(scenery, (width, height));
        }
        look
    }

    fn through_lens(
        scenery: Scenery<'_>,
        place: Place<'p>,
        (width, height): (usize, usize),
    ) -> Self {
        let mut look = Self {
            place,
            tile: Tile::new(width, height),
            bent: vec![DVec3::NAN; STRIDE * SIZE],
        };
        for spot in spots(width, height) {
            let direction = place
                .eye
                .direction(place.column + spot.column, place.row + spot.row);
            look.bent[spot.index()] = direction;
            if direction.is_finite() {
                look.tile
                    .put(spot, trace(scenery, &place.eye.frame, direction));
            }
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
        if self.bent.is_empty() {
            let place = &self.place;
            return place
                .eye
                .direction(place.column + spot.column, place.row + spot.row);
        }
        self.bent[spot.index()]
    }

    /// The visible triangles of samples side by side from `first` on, [`NONE`] where there is none.
    pub(crate) fn triangles(&self, first: Spot, width: usize) -> &[u32] {
        &self.tile.row(first.row, first.column + width)[first.column..]
    }

    /// Whether the directions of a row's samples differ from another row's in y alone.
    pub(crate) fn is_straight(&self) -> bool {
        self.bent.is_empty()
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
        self.bent.is_empty() || self.bent[spot.index()].is_finite()
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
