//! A view tile by tile: what is visible, then its exact depth, normal and colour.

use super::clusters::Clusters;
use super::eye::Eye;
use super::lens::Place;
use super::scan::scan;
use super::surface::{Facet, Frame, Patch};
use super::tile::{SIZE, Spot, Tile};
use super::{Pixel, RenderOptions, Rendering, mean_color};
use crate::error::Result;
use crate::parallel;
use glam::{DVec3, Vec3};
use mvs_datasets::scene::{DepthMap, Raster};

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
    let corner = |index: usize| (index % across * SIZE, index / across * SIZE);
    let tiles = parallel::map(across * height.div_ceil(SIZE), |index| {
        let (column, row) = corner(index);
        let size = (SIZE.min(width - column), SIZE.min(height - row));
        painter.paint((column, row), size)
    });
    let mut whole = Maps::empty(width * height, options);
    for (index, tile) in tiles.iter().enumerate() {
        if let Some(tile) = tile {
            whole.put(tile, corner(index), width);
        }
    }
    whole.finish((camera.width(), camera.height()))
}

/// The columns of a rendering, or of a tile of it.
struct Maps {
    width: usize,
    color: Vec<[u8; 3]>,
    depth: Vec<f32>,
    normals: Vec<[f32; 3]>,
}

impl Maps {
    fn empty(count: usize, options: &RenderOptions) -> Self {
        Self {
            width: 0,
            color: vec![options.background; count],
            depth: vec![0.0; count],
            normals: vec![[0.0; 3]; count],
        }
    }

    /// Copies a tile to where its first pixel is (`column`, `row`).
    fn put(&mut self, tile: &Self, (column, row): (usize, usize), width: usize) {
        for (index, from) in (0..tile.depth.len()).step_by(tile.width).enumerate() {
            let to = (row + index) * width + column;
            let (from, to) = (from..from + tile.width, to..to + tile.width);
            self.color[to.clone()].copy_from_slice(&tile.color[from.clone()]);
            self.depth[to.clone()].copy_from_slice(&tile.depth[from.clone()]);
            self.normals[to].copy_from_slice(&tile.normals[from]);
        }
    }

    fn set(&mut self, index: usize, pixel: &Pixel) {
        self.color[index] = pixel.color;
        self.depth[index] = pixel.depth;
        self.normals[index] = pixel.normal;
    }

    fn finish(self, (width, height): (u32, u32)) -> Result<Rendering> {
        Ok(Rendering {
            color: Raster::from_values(width, height, self.color)?,
            depth: DepthMap::from_values(width, height, self.depth)?.0,
            normals: Raster::from_values(width, height, self.normals)?,
        })
    }
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
        tile.count()
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
    /// The pixels of a tile whose first pixel is (`column`, `row`); `None` when it is empty.
    fn paint(
        &self,
        (column, row): (usize, usize),
        (width, height): (usize, usize),
    ) -> Option<Maps> {
        let place = Place {
            eye: &self.pixels,
            column,
            row,
        };
        let tile = scan(self.clusters, &place, (width, height));
        if tile.is_blank() {
            return None;
        }
        let mut maps = Maps::empty(width * height, self.options);
        maps.width = width;
        let mut facets = Kept::new();
        for row in 0..height {
            for column in 0..width {
                let spot = Spot { column, row };
                if let Some(triangle) = tile.triangle(spot) {
                    let pixel = resolve((&place, &tile), (spot, triangle), &mut facets);
                    maps.set(row * width + column, &pixel);
                }
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
                    &mut maps.color,
                );
            }
        }
        Some(maps)
    }

    /// Gives the pixels of a part of a tile, `size` pixels from `corner` on, their colours.
    fn color(
        &self,
        (place, centers): (&Place<'_>, &Tile),
        corner: Spot,
        ((width, height), stride): ((usize, usize), usize),
        colors: &mut [[u8; 3]],
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
            colors[spot.row * stride + spot.column] = color;
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
        None => f64::from(tile.nearness(spot)).recip(),
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
