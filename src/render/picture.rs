//! A view tile by tile: what is visible, then its exact depth, normal and colour.

use super::clusters::Clusters;
use super::eye::Eye;
use super::raster::Place;
use super::scan::scan;
use super::surface::{Facet, Frame, Patch};
use super::tile::{NONE, SIZE, Spot, Tile};
use super::{Pixel, RenderOptions, Rendering, assembled, mean_color};
use crate::error::Result;
use crate::parallel;
use glam::{DVec3, Vec3};

/// Renders a view with `side` × `side` colour samples per pixel.
pub(crate) fn render(
    clusters: &Clusters,
    frame: &Frame<'_>,
    (side, options): (u32, &RenderOptions),
) -> Result<Rendering> {
    let camera = frame.camera();
    let (width, height) = (camera.width() as usize, camera.height() as usize);
    let painter = Painter {
        clusters,
        pixels: Eye::new(*frame, 1),
        samples: Eye::new(*frame, side),
        options,
    };
    let across = width.div_ceil(SIZE);
    let tiles = parallel::map(across * height.div_ceil(SIZE), |index| {
        let (column, row) = (index % across * SIZE, index / across * SIZE);
        painter.paint(
            (column, row),
            (SIZE.min(width - column), SIZE.min(height - row)),
        )
    });
    let pixels = (0..height).flat_map(|row| {
        let tiles = &tiles;
        (0..width).map(move |column| {
            let tile = &tiles[row / SIZE * across + column / SIZE];
            tile[row % SIZE * SIZE.min(width - column / SIZE * SIZE) + column % SIZE]
        })
    });
    assembled((camera.width(), camera.height()), pixels)
}

/// How many pixels of a view see the surface.
pub(crate) fn visible_count(clusters: &Clusters, frame: &Frame<'_>) -> usize {
    let camera = frame.camera();
    let (width, height) = (camera.width() as usize, camera.height() as usize);
    let eye = Eye::new(*frame, 1);
    let across = width.div_ceil(SIZE);
    let counts = parallel::map(across * height.div_ceil(SIZE), |index| {
        let (column, row) = (index % across * SIZE, index / across * SIZE);
        let place = Place {
            eye: &eye,
            column,
            row,
        };
        let tile = scan(
            clusters,
            &place,
            (SIZE.min(width - column), SIZE.min(height - row)),
        );
        tile.triangles
            .iter()
            .filter(|&&triangle| triangle != NONE)
            .count()
    });
    counts.into_iter().sum()
}

/// What all tiles of a view share.
struct Painter<'p> {
    clusters: &'p Clusters,
    /// The grid of pixel centres.
    pixels: Eye<'p>,
    /// The grid of colour samples.
    samples: Eye<'p>,
    options: &'p RenderOptions,
}

impl<'p> Painter<'p> {
    /// The pixels of a tile whose first pixel is (`column`, `row`), row by row.
    fn paint(&self, (column, row): (usize, usize), (width, height): (usize, usize)) -> Vec<Pixel> {
        let place = Place {
            eye: &self.pixels,
            column,
            row,
        };
        let tile = scan(self.clusters, &place, (width, height));
        let mut pixels = vec![Pixel::empty(self.options); width * height];
        let mut facets = Kept::new();
        for (index, pixel) in pixels.iter_mut().enumerate() {
            let spot = Spot {
                column: index % width,
                row: index / width,
            };
            if let Some(triangle) = tile.triangle(spot) {
                *pixel = resolve((&place, &tile), (spot, triangle), &mut facets);
            }
        }
        let side = self.samples.side() as usize;
        let step = SIZE / side; // Whole pixels whose samples fit into one tile.
        for top in (0..height).step_by(step) {
            for left in (0..width).step_by(step) {
                let size = (step.min(width - left), step.min(height - top));
                self.color(
                    (&place, &tile),
                    Spot {
                        column: left,
                        row: top,
                    },
                    (size, width),
                    &mut pixels,
                );
            }
        }
        pixels
    }

    /// Gives the pixels of a part of a tile, `size` pixels from `corner` on, their colours.
    fn color(
        &self,
        (place, centers): (&Place<'_>, &Tile),
        corner: Spot,
        ((width, height), stride): ((usize, usize), usize),
        pixels: &mut [Pixel],
    ) {
        let spots = || {
            (0..width * height).map(|index| Spot {
                column: corner.column + index % width,
                row: corner.row + index / width,
            })
        };
        if !spots().any(|spot| centers.triangle(spot).is_some()) {
            return;
        }
        let side = self.samples.side() as usize;
        let first = Place {
            eye: &self.samples,
            column: (place.column + corner.column) * side,
            row: (place.row + corner.row) * side,
        };
        let fine = (side > 1).then(|| scan(self.clusters, &first, (width * side, height * side)));
        let mut patches = Kept::new();
        for spot in spots() {
            let Some(center) = centers.triangle(spot) else {
                continue;
            };
            let (column, row) = (spot.column - corner.column, spot.row - corner.row);
            let at_center = self
                .pixels
                .direction(place.column + spot.column, place.row + spot.row);
            let color = match &fine {
                None => mean_color(
                    std::iter::once(self.shade(&mut patches, center, at_center)),
                    || Vec3::ZERO,
                ),
                Some(fine) => self.mean(
                    (&first, fine),
                    (column, row),
                    (center, at_center),
                    &mut patches,
                ),
            };
            pixels[spot.row * stride + spot.column].color = color;
        }
    }

    fn shade(&self, patches: &mut Kept<Patch<'p>>, triangle: u32, direction: DVec3) -> Vec3 {
        let make = || self.samples.frame.patch(triangle as usize);
        patches.get(triangle, make).color(direction)
    }

    /// The mean colour of a pixel's samples.
    fn mean(
        &self,
        (first, fine): (&Place<'_>, &Tile),
        (column, row): (usize, usize),
        (center, at_center): (u32, DVec3),
        patches: &mut Kept<Patch<'p>>,
    ) -> [u8; 3] {
        let side = self.samples.side() as usize;
        let mut sum = Vec3::ZERO;
        let mut count = 0.0;
        for index in 0..side * side {
            let spot = Spot {
                column: column * side + index % side,
                row: row * side + index / side,
            };
            if let Some(triangle) = fine.triangle(spot) {
                let direction = self
                    .samples
                    .direction(first.column + spot.column, first.row + spot.row);
                sum += self.shade(patches, triangle, direction);
                count += 1.0;
            }
        }
        if count == 0.0 {
            return mean_color(std::iter::empty(), || {
                self.shade(patches, center, at_center)
            });
        }
        mean_color(std::iter::once(sum / count), || Vec3::ZERO)
    }
}

/// Depth and normal at a pixel's centre.
fn resolve(
    (place, tile): (&Place<'_>, &Tile),
    (spot, triangle): (Spot, u32),
    facets: &mut Kept<Facet>,
) -> Pixel {
    let direction = place
        .eye
        .direction(place.column + spot.column, place.row + spot.row);
    let facet = facets.get(triangle, || place.eye.frame.facet(triangle as usize));
    let crossing = facet.cross(direction);
    debug_assert!(crossing.is_some(), "the fast path saw what is not there");
    let distance = match crossing {
        Some(crossing) => crossing.distance,
        None => f64::from(tile.nearness[spot.row * SIZE + spot.column]).recip(),
    };
    Pixel::new(facet, distance, direction, [0; 3])
}

/// What has been worked out about triangles, each once while it is in use.
struct Kept<T> {
    slots: Vec<Option<(u32, T)>>,
}

impl<T> Kept<T> {
    const SLOTS: usize = 256;

    fn new() -> Self {
        Self {
            slots: std::iter::repeat_with(|| None).take(Self::SLOTS).collect(),
        }
    }

    fn get(&mut self, triangle: u32, make: impl FnOnce() -> T) -> &T {
        let slot = &mut self.slots[triangle as usize % Self::SLOTS];
        if slot.as_ref().is_none_or(|(kept, _)| *kept != triangle) {
            *slot = None;
        }
        &slot.get_or_insert_with(|| (triangle, make())).1
    }
}
