//! A view tile by tile: what is visible, then its exact depth, normal and colour.

use super::clusters::Clusters;
use super::eye::Eye;
use super::raster::Place;
use super::scan::scan;
use super::surface::{Frame, Patch};
use super::tile::{SIZE, Spot, Tile};
use super::triangle::Crossing;
use super::{Pixel, RenderOptions, Rendering, Visible, assembled, mean_color};
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
        for (index, pixel) in pixels.iter_mut().enumerate() {
            let spot = Spot {
                column: index % width,
                row: index / width,
            };
            if let Some(triangle) = tile.triangle(spot) {
                *pixel = resolve(&place, &tile, spot, triangle);
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
        let mut patches = Patches::new(self.samples.frame);
        for spot in spots() {
            let Some(center) = centers.triangle(spot) else {
                continue;
            };
            let (column, row) = (spot.column - corner.column, spot.row - corner.row);
            let at_center = self
                .pixels
                .direction(place.column + spot.column, place.row + spot.row);
            let color = match &fine {
                None => mean_color(std::iter::once(patches.color(center, at_center)), || {
                    Vec3::ZERO
                }),
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

    /// The mean colour of a pixel's samples.
    fn mean(
        &self,
        (first, fine): (&Place<'_>, &Tile),
        (column, row): (usize, usize),
        (center, at_center): (u32, DVec3),
        patches: &mut Patches<'p>,
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
                sum += patches.color(triangle, direction);
                count += 1.0;
            }
        }
        if count == 0.0 {
            return mean_color(std::iter::empty(), || patches.color(center, at_center));
        }
        mean_color(std::iter::once(sum / count), || Vec3::ZERO)
    }
}

/// Depth and normal at a pixel's centre.
fn resolve(place: &Place<'_>, tile: &Tile, spot: Spot, triangle: u32) -> Pixel {
    let (column, row) = (place.column + spot.column, place.row + spot.row);
    let direction = place.eye.direction(column, row);
    let crossing = place.eye.frame.cross(triangle as usize, direction);
    debug_assert!(crossing.is_some(), "the fast path saw what is not there");
    let crossing = crossing.unwrap_or_else(|| Crossing {
        distance: f64::from(tile.nearness[spot.row * SIZE + spot.column]).recip(),
        weights: [0.0; 2],
    });
    let visible = Visible {
        triangle: triangle as usize,
        crossing,
    };
    Pixel::new(&place.eye.frame, &visible, direction, [0; 3])
}

/// Patches in use, each made once while its triangle stays near.
struct Patches<'m> {
    frame: Frame<'m>,
    kept: Vec<Option<(u32, Patch<'m>)>>,
}

impl<'m> Patches<'m> {
    const KEPT: usize = 256;

    fn new(frame: Frame<'m>) -> Self {
        Self {
            frame,
            kept: vec![None; Self::KEPT],
        }
    }

    fn color(&mut self, triangle: u32, direction: DVec3) -> Vec3 {
        let slot = &mut self.kept[triangle as usize % Self::KEPT];
        match slot {
            Some((kept, patch)) if *kept == triangle => patch.color(direction),
            _ => {
                let patch = self.frame.patch(triangle as usize);
                *slot = Some((triangle, patch));
                patch.color(direction)
            }
        }
    }
}
