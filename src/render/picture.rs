//! A view tile by tile: what is visible, then its exact depth, normal and colour.

use super::eye::Eye;
use super::lanes::LANES;
use super::lens::Place;
use super::look::{Look, Scenery, spots};
use super::maps::Resolver;
use super::shade::{Row, runs};
use super::sight::{Samples, Sight};
use super::surface::{Facet, Frame, Patch};
use super::texture::Parts;
use super::tile::{SIZE, Spot};
use super::{Pixel, RenderOptions, Rendering, Seen};
use crate::error::Result;
use crate::parallel;
use mvs_datasets::scene::{DepthMap, Raster};
use std::ops::Range;

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
    let count = across * height.div_ceil(SIZE);
    let mut whole = Maps::empty((width, width * height), options);
    // Some at a time: they are copied while they are near, and need little memory.
    let some = 32 * parallel::threads();
    for first in (0..count).step_by(some) {
        let tiles = parallel::map_with(some.min(count - first), Easel::new, |easel, index| {
            let (column, row) = corner(first + index);
            let size = (SIZE.min(width - column), SIZE.min(height - row));
            painter.paint((column, row), size, easel)
        });
        for (index, tile) in tiles.iter().enumerate() {
            if let Some(tile) = tile {
                whole.put(tile, corner(first + index));
            }
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

    /// Takes depth and normals of all pixels; `is_hollow` tells of a triangle whether what is seen of it
    /// is no surface.
    fn take(&mut self, seen: &Seen, mut is_hollow: impl FnMut(u32) -> bool) {
        self.depth.copy_from_slice(&seen.depth);
        self.normals.copy_from_slice(&seen.normals);
        for (triangle, (from, to)) in runs(&seen.triangles) {
            let sight = match triangle {
                None => continue,
                Some(triangle) if is_hollow(triangle) => Sight::BackFace,
                Some(_) => Sight::Surface,
            };
            self.sight[from..to].fill(sight);
            if sight == Sight::BackFace {
                self.depth[from..to].fill(0.0);
                self.normals[from..to].fill([0.0; 3]);
            }
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

    /// Whether some of these pixels show surface.
    fn is_surface(&self, pixels: Range<usize>) -> bool {
        self.sight[pixels].contains(&Sight::Surface)
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

/// What one tile after the other is worked out with.
struct Easel<'p> {
    resolver: Resolver,
    seen: Seen,
    hollow: Kept<bool>,
    patches: Kept<Patch<'p>>,
    samples: Row,
}

impl Easel<'_> {
    fn new() -> Self {
        Self {
            resolver: Resolver::new(),
            seen: Seen::default(),
            hollow: Kept::new(),
            patches: Kept::new(),
            samples: Row::new(),
        }
    }
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
        easel: &mut Easel<'p>,
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
        if look.is_straight() && !self.options.interpolated_normals {
            let tile = (&place, look.tile());
            let Easel {
                resolver,
                seen,
                hollow,
                ..
            } = &mut *easel;
            resolver.resolve_tile(tile, (width, height), seen);
            maps.take(seen, |triangle| {
                let is_hollow = || self.pixels.frame.is_hollow(triangle as usize);
                *hollow.get(triangle, is_hollow)
            });
        } else {
            let mut facets = Kept::new();
            for spot in spots(width, height) {
                let pixel = resolve(&look, (spot, &self.pixels.frame), &mut facets);
                maps.set(spot.row * width + spot.column, &pixel);
            }
        }
        let centers = Centers { look, column, row };
        let side = self.samples.side() as usize;
        let step = SIZE / side; // Whole pixels whose samples fit into one tile.
        for top in (0..height).step_by(step) {
            for left in (0..width).step_by(step) {
                let part = Part {
                    column: left,
                    row: top,
                    width: step.min(width - left),
                    height: step.min(height - top),
                };
                self.color(&centers, &part, easel, &mut maps);
            }
        }
        Some(maps)
    }

    /// Gives the pixels of a part of a tile their colours.
    fn color(&self, centers: &Centers<'_>, part: &Part, easel: &mut Easel<'p>, maps: &mut Maps) {
        let (patches, samples) = (&mut easel.patches, &mut easel.samples);
        if !part.rows(maps.width).any(|pixels| maps.is_surface(pixels)) {
            return;
        }
        let side = self.samples.side() as usize;
        let place = Place {
            eye: &self.samples,
            column: (centers.column + part.column) * side,
            row: (centers.row + part.row) * side,
        };
        let size = (part.width * side, part.height * side);
        let fine = (side > 1).then(|| Look::new(self.scenery, place, size));
        // A pixel's only sample is its centre.
        let (look, first) = match &fine {
            Some(look) => (look, Spot { column: 0, row: 0 }),
            None => (&centers.look, part.corner()),
        };
        let mut again = false;
        for (row, pixels) in part.rows(maps.width).enumerate() {
            if !maps.is_surface(pixels.clone()) {
                continue;
            }
            let mut sums = [Samples::default(); SIZE];
            samples.expect(&maps.depth[pixels.clone()], side);
            for down in 0..side {
                let first = Spot {
                    row: first.row + row * side + down,
                    ..first
                };
                samples.aim(look, (first, size.0), again);
                again = true;
                for (triangle, range) in runs(look.triangles(first, size.0)) {
                    let make = |triangle: u32| self.samples.frame.patch(triangle as usize);
                    let patch = triangle.map(|id| patches.get(id, || make(id)));
                    samples.add(patch, range, (&mut sums, side));
                }
            }
            for (column, (index, sums)) in pixels.zip(sums).enumerate() {
                if maps.sight[index] != Sight::Surface {
                    continue;
                }
                let at = Spot {
                    column: part.column + column,
                    row: part.row + row,
                };
                maps.paint(index, sums.finish(|| self.at_center(&centers.look, at)));
            }
        }
    }

    /// The colour at a pixel's centre.
    fn at_center(&self, look: &Look<'_>, at: Spot) -> Parts {
        look.triangle(at).map_or([0.0; LANES], |triangle| {
            let patch = self.samples.frame.patch(triangle as usize);
            patch.glimpse(look.direction(at)).color
        })
    }
}

/// A part of a tile, in pixels.
struct Part {
    column: usize,
    row: usize,
    width: usize,
    height: usize,
}

impl Part {
    fn corner(&self) -> Spot {
        Spot {
            column: self.column,
            row: self.row,
        }
    }

    /// Where each of its rows stands among the pixels of the tile, which is `stride` wide.
    fn rows(&self, stride: usize) -> impl Iterator<Item = Range<usize>> + use<> {
        let (column, width) = (self.column, self.width);
        (self.row..self.row + self.height).map(move |row| {
            let start = row * stride + column;
            start..start + width
        })
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
    if facet.is_hollow() {
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
