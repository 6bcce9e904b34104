//! A view tile by tile: what is visible, then its exact depth, normal and colour.

use super::eye::Eye;
use super::lanes::LANES;
use super::lens::Place;
use super::look::{Look, Scenery, spots};
use super::maps::Resolver;
use super::paint::Painting;
use super::shade::Brushes;
use super::sight::{Samples, Sight};
use super::surface::{Facet, Frame};
use super::texture::Parts;
use super::tile::{NONE, SIDE, SIZE, Spot};
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
    /// Empty where not wanted, as the next.
    normals: Vec<[f32; 3]>,
    interpolated: Vec<[f32; 3]>,
    sight: Vec<Sight>,
}

impl Maps {
    /// Maps of `count` pixels, `width` in a row, that see nothing.
    pub(crate) fn empty((width, count): (usize, usize), options: &RenderOptions) -> Self {
        let normals = |wanted| match wanted {
            true => vec![[0.0; 3]; count],
            false => Vec::new(),
        };
        Self {
            width,
            color: vec![options.background; count],
            depth: vec![0.0; count],
            normals: normals(options.normals),
            interpolated: normals(options.interpolated_normals),
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
            if !self.normals.is_empty() {
                self.normals[to.clone()].copy_from_slice(&tile.normals[from.clone()]);
            }
            if !self.interpolated.is_empty() {
                self.interpolated[to.clone()].copy_from_slice(&tile.interpolated[from.clone()]);
            }
            self.sight[to].copy_from_slice(&tile.sight[from]);
        }
    }

    /// Takes depth and normals of all pixels; `is_hollow` tells of a triangle whether what is seen of it
    /// is no surface.
    fn take(&mut self, seen: &mut Seen, mut is_hollow: impl FnMut(u32) -> bool) {
        std::mem::swap(&mut self.depth, &mut seen.depth);
        if !self.normals.is_empty() {
            std::mem::swap(&mut self.normals, &mut seen.normals);
        }
        for (triangle, pixels) in runs(&seen.triangles) {
            let sight = match triangle {
                None => continue,
                Some(triangle) if is_hollow(triangle) => Sight::BackFace,
                Some(_) => Sight::Surface,
            };
            self.sight[pixels.clone()].fill(sight);
            if sight == Sight::BackFace {
                self.depth[pixels.clone()].fill(0.0);
                if !self.normals.is_empty() {
                    self.normals[pixels].fill([0.0; 3]);
                }
            }
        }
    }

    /// Sets everything but the colour.
    pub(crate) fn set(&mut self, index: usize, pixel: &Pixel) {
        self.depth[index] = pixel.depth;
        if let Some(normal) = self.normals.get_mut(index) {
            *normal = pixel.normal;
        }
        if let Some(interpolated) = self.interpolated.get_mut(index) {
            *interpolated = pixel.interpolated;
        }
        self.sight[index] = pixel.sight;
    }

    /// What these pixels show.
    #[inline(always)]
    pub(crate) fn sights(&self, pixels: &Range<usize>) -> &[Sight] {
        &self.sight[pixels.clone()]
    }

    /// The depths of these pixels.
    #[inline(always)]
    pub(crate) fn depths(&self, pixels: &Range<usize>) -> &[f32] {
        &self.depth[pixels.clone()]
    }

    /// The colours of these pixels.
    #[inline(always)]
    pub(crate) fn colors(&mut self, pixels: &Range<usize>) -> &mut [[u8; 3]] {
        &mut self.color[pixels.clone()]
    }

    /// Sets a pixel's colour if it shows surface, and whether the samples agree.
    pub(crate) fn paint(
        &mut self,
        index: usize,
        samples: Samples,
        at_center: impl FnOnce() -> Parts,
    ) {
        if self.sight[index] == Sight::Surface {
            (self.color[index], self.sight[index]) = samples.finish(at_center);
        }
    }

    pub(crate) fn finish(self, (width, height): (u32, u32)) -> Result<Rendering> {
        let map = |normals: Vec<_>| {
            let wanted = !normals.is_empty();
            wanted.then(|| Raster::from_values(width, height, normals))
        };
        Ok(Rendering {
            color: Raster::from_values(width, height, self.color)?,
            depth: DepthMap::from_values(width, height, self.depth)?.0,
            normals: map(self.normals).transpose()?,
            interpolated_normals: map(self.interpolated).transpose()?,
            sight: Raster::from_values(width, height, self.sight)?,
        })
    }
}

/// Runs of pixels that see one triangle, or none: which, and where they begin and end.
fn runs(triangles: &[u32]) -> impl Iterator<Item = (Option<u32>, Range<usize>)> {
    let mut from = 0;
    std::iter::from_fn(move || {
        let &triangle = triangles.get(from)?;
        let others = triangles[from..].iter().position(|&next| next != triangle);
        let to = others.map_or(triangles.len(), |count| from + count);
        let run = ((triangle != NONE).then_some(triangle), from..to);
        from = to;
        Some(run)
    })
}

/// How many pixels of a view see the surface, its backs included.
pub(crate) fn visible_count(scenery: Scenery<'_>, frame: &Frame<'_>) -> usize {
    let camera = frame.camera();
    let (width, height) = (camera.width() as usize, camera.height() as usize);
    let eye = Eye::new(*frame, 1);
    // Behind a lens, the more samples a tile has, the less evenly they lie.
    let size = if eye.is_bent() { SIZE } else { SIDE };
    let across = width.div_ceil(size);
    let counts = parallel::map(across * height.div_ceil(size), |index| {
        let (column, row) = (index % across * size, index / across * size);
        let place = Place {
            eye: &eye,
            column,
            row,
        };
        let used = (size.min(width - column), size.min(height - row));
        let look = Look::new(scenery, place, used);
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
    brushes: Brushes<'p>,
}

impl Easel<'_> {
    fn new() -> Self {
        Self {
            resolver: Resolver::new(),
            seen: Seen::default(),
            brushes: Brushes::new(),
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
                brushes,
            } = &mut *easel;
            resolver.resolve_tile(tile, (width, height), seen);
            brushes.tidy();
            // Most are painted next.
            maps.take(seen, |triangle| {
                brushes.is_hollow(triangle, &self.pixels.frame)
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
        let rows: Vec<Range<usize>> = part.rows(maps.width).collect();
        let shows = |pixels| maps.sights(pixels).contains(&Sight::Surface);
        if !rows.iter().any(shows) {
            return;
        }
        let side = self.samples.side() as usize;
        let place = Place {
            eye: &self.samples,
            column: (centers.column + part.column) * side,
            row: (centers.row + part.row) * side,
        };
        let size = (part.width * side, part.height * side);
        // A pixel's only sample is its centre, and the part is the tile.
        let fine = (side > 1).then(|| Look::new(self.scenery, place, size));
        let stride = maps.width;
        let painting = Painting {
            brushes: &mut easel.brushes,
            look: fine.as_ref().unwrap_or(&centers.look),
            frame: &self.samples.frame,
            side,
            maps,
            rows: &rows,
        };
        painting.run(|index| {
            let at = Spot {
                column: index % stride,
                row: index / stride,
            };
            self.at_center(&centers.look, at)
        });
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
    /// Where each of its rows stands among the pixels of the tile, which is `stride` wide.
    fn rows(&self, stride: usize) -> impl Iterator<Item = Range<usize>> {
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
