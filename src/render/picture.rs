//! A view tile by tile: what is visible, then its exact depth, normal and colour.

use super::eye::Eye;
use super::lens::Place;
use super::look::{Look, Scenery, spots};
use super::sight::{Samples, Sight};
use super::surface::{Facet, Frame, Patch};
use super::tile::{SIZE, Spot};
use super::{Pixel, RenderOptions, Rendering};
use crate::error::Result;
use crate::parallel;
use mvs_datasets::scene::{DepthMap, Raster};

/// Renders a view with `side` × `side` colour samples per pixel.
pub(crate) fn render(
    scenery: Scenery<'_>,
    frame: &Frame<'_>,
    (side, options): (u32, &RenderOptions),
) -> Result<Rendering> {
    let camera = frame.camera();
    let (width, height) = (camera.width() as usize, camera.height() as usize);
    let painter = Painter {
        scenery,
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
    let mut whole = Maps::empty((width, width * height), options);
    for (index, tile) in tiles.iter().enumerate() {
        if let Some(tile) = tile {
            whole.put(tile, corner(index));
        }
    }
    whole.finish((camera.width(), camera.height()))
}

/// The columns of a rendering, or of a tile of it.
pub(crate) struct Maps {
    width: usize,
    color: Vec<[u8; 3]>,
    depth: Vec<f32>,
    normals: Vec<[f32; 3]>,
    /// Empty where not wanted.
    interpolated: Vec<[f32; 3]>,
    sight: Vec<Sight>,
}

impl Maps {
    /// Maps of `count` pixels, `width` in a row, that see nothing.
    pub(crate) fn empty((width, count): (usize, usize), options: &RenderOptions) -> Self {
        Self {
            width,
            color: vec![options.background; count],
            depth: vec![0.0; count],
            normals: vec![[0.0; 3]; count],
            interpolated: match options.interpolated_normals {
                true => vec![[0.0; 3]; count],
                false => Vec::new(),
            },
            sight: vec![Sight::Nothing; count],
        }
    }

    /// Copies a tile to where its first pixel is (`column`, `row`).
    fn put(&mut self, tile: &Self, (column, row): (usize, usize)) {
        for (index, from) in (0..tile.depth.len()).step_by(tile.width).enumerate() {
            let to = (row + index) * self.width + column;
            let (from, to) = (from..from + tile.width, to..to + tile.width);
            self.color[to.clone()].copy_from_slice(&tile.color[from.clone()]);
            self.depth[to.clone()].copy_from_slice(&tile.depth[from.clone()]);
            self.normals[to.clone()].copy_from_slice(&tile.normals[from.clone()]);
            if !self.interpolated.is_empty() {
                self.interpolated[to.clone()].copy_from_slice(&tile.interpolated[from.clone()]);
            }
            self.sight[to].copy_from_slice(&tile.sight[from]);
        }
    }

    /// Sets everything but the colour.
    pub(crate) fn set(&mut self, index: usize, pixel: &Pixel) {
        self.depth[index] = pixel.depth;
        self.normals[index] = pixel.normal;
        if let Some(interpolated) = self.interpolated.get_mut(index) {
            *interpolated = pixel.interpolated;
        }
        self.sight[index] = pixel.sight;
    }

    /// Sets the colour, and whether the samples agree.
    pub(crate) fn paint(&mut self, index: usize, (color, sight): ([u8; 3], Sight)) {
        self.color[index] = color;
        self.sight[index] = sight;
    }

    pub(crate) fn finish(self, (width, height): (u32, u32)) -> Result<Rendering> {
        let wanted = !self.interpolated.is_empty();
        let interpolated = wanted.then(|| Raster::from_values(width, height, self.interpolated));
        Ok(Rendering {
            color: Raster::from_values(width, height, self.color)?,
            depth: DepthMap::from_values(width, height, self.depth)?.0,
            normals: Raster::from_values(width, height, self.normals)?,
            interpolated_normals: interpolated.transpose()?,
            sight: Raster::from_values(width, height, self.sight)?,
        })
    }
}

/// How many pixels of a view see the surface, its backs included.
pub(crate) fn visible_count(scenery: Scenery<'_>, frame: &Frame<'_>) -> usize {
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
        let size = (SIZE.min(width - column), SIZE.min(height - row));
        let look = Look::new(scenery, place, size);
        look.count()
    });
    counts.into_iter().sum()
}

/// What all tiles of a view share.
struct Painter<'p> {
    scenery: Scenery<'p>,
    /// The grid of pixel centres.
    pixels: Eye<'p>,
    /// The grid of colour samples.
    samples: Eye<'p>,
    options: &'p RenderOptions,
}

/// What the pixel centres of a tile see, and where the tile is.
struct Centers<'p> {
    look: Look<'p>,
    column: usize,
    row: usize,
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
        let look = Look::new(self.scenery, place, (width, height));
        if look.is_blank((width, height)) {
            return None;
        }
        let mut maps = Maps::empty((width, width * height), self.options);
        let mut facets = Kept::new();
        for spot in spots(width, height) {
            let pixel = resolve(&look, (spot, &self.pixels.frame), &mut facets);
            maps.set(spot.row * width + spot.column, &pixel);
        }
        let centers = Centers { look, column, row };
        let side = self.samples.side() as usize;
        let step = SIZE / side; // Whole pixels whose samples fit into one tile.
        for top in (0..height).step_by(step) {
            for left in (0..width).step_by(step) {
                let size = (step.min(width - left), step.min(height - top));
                let corner = Spot {
                    column: left,
                    row: top,
                };
                self.color(&centers, (corner, size), &mut maps);
            }
        }
        Some(maps)
    }

    /// Gives the pixels of a part of a tile, `width` × `height` pixels from `corner` on, their
    /// colours.
    fn color(
        &self,
        centers: &Centers<'p>,
        (corner, (width, height)): (Spot, (usize, usize)),
        maps: &mut Maps,
    ) {
        let place_of = |spot: Spot| Spot {
            column: corner.column + spot.column,
            row: corner.row + spot.row,
        };
        let stride = maps.width;
        let index_of = |spot: Spot| place_of(spot).row * stride + place_of(spot).column;
        let is_surface = |maps: &Maps, spot: Spot| maps.sight[index_of(spot)] == Sight::Surface;
        if !spots(width, height).any(|spot| is_surface(maps, spot)) {
            return;
        }
        let side = self.samples.side() as usize;
        let first = Place {
            eye: &self.samples,
            column: (centers.column + corner.column) * side,
            row: (centers.row + corner.row) * side,
        };
        let fine =
            (side > 1).then(|| Look::new(self.scenery, first, (width * side, height * side)));
        let mut patches = Kept::new();
        for spot in spots(width, height) {
            if !is_surface(maps, spot) {
                continue;
            }
            let index = index_of(spot);
            let at = place_of(spot);
            let center = (&centers.look, at);
            let samples = Samples::new(f64::from(maps.depth[index]));
            let painted = match &fine {
                None => self.mean((&centers.look, at), (samples, center), &mut patches),
                Some(fine) => {
                    let corner = Spot {
                        column: spot.column * side,
                        row: spot.row * side,
                    };
                    self.mean((fine, corner), (samples, center), &mut patches)
                }
            };
            maps.paint(index, painted);
        }
    }

    /// The colour of a pixel whose first sample is at `corner`.
    fn mean(
        &self,
        (look, corner): (&Look<'p>, Spot),
        (mut samples, center): (Samples, (&Look<'p>, Spot)),
        patches: &mut Kept<Patch<'p>>,
    ) -> ([u8; 3], Sight) {
        let frame = &self.samples.frame;
        let mut glimpse = |look: &Look<'p>, spot: Spot| {
            let triangle = look.triangle(spot)?;
            let patch = patches.get(triangle, || frame.patch(triangle as usize));
            Some(patch.glimpse(look.direction(spot)))
        };
        let side = self.samples.side() as usize;
        for inside in spots(side, side) {
            let spot = Spot {
                column: corner.column + inside.column,
                row: corner.row + inside.row,
            };
            samples.add(glimpse(look, spot));
        }
        samples.finish(|| glimpse(center.0, center.1).map_or_else(Default::default, |g| g.color))
    }
}

/// Everything but the colour at a pixel's centre.
fn resolve(look: &Look<'_>, (spot, frame): (Spot, &Frame<'_>), facets: &mut Kept<Facet>) -> Pixel {
    let Some(triangle) = look.triangle(spot) else {
        return Pixel::without_surface(match look.has_ray(spot) {
            true => Sight::Nothing,
            false => Sight::NoRay,
        });
    };
    let direction = look.direction(spot);
    let facet = facets.get(triangle, || frame.facet(triangle as usize));
    if facet.is_hollow(direction) {
        return Pixel::without_surface(Sight::BackFace);
    }
    let crossing = facet.cross(direction);
    debug_assert!(crossing.is_some(), "the fast path saw what is not there");
    let (distance, weights) = match crossing {
        Some(crossing) => (crossing.distance, crossing.weights),
        None => (f64::from(look.nearness(spot)).recip(), [0.0; 2]),
    };
    let mut pixel = Pixel::new(facet, distance, direction);
    if frame.has_vertex_normals() {
        let of = (triangle as usize, facet);
        let normal = frame.interpolated_normal(of, weights, direction);
        pixel.interpolated = normal.as_vec3().into();
    }
    pixel
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
