//! What clustering asks of pixels, in square tiles that come and go within a budget of memory.
//!
//! A cluster may reach any view, so no order of work keeps few whole maps in memory; but pixels that
//! lie side by side reach pixels that lie side by side. Tiles without a depth take no room.

use super::inputs::{DepthMaps, Scratch};
use super::normals;
use super::options::FuseOptions;
use super::points::Columns;
use super::samples::{Filters, Samples, prepare};
use crate::ahead::prefetch;
use crate::error::{Error, Result};
use glam::{DVec2, Vec3};
use mvs_datasets::scene::{ColorImage, NormalMap, View};
use std::ops::Range;

/// Edge of a tile in pixels.
const EDGE: usize = 32;
const PIXELS: usize = EDGE * EDGE;
/// Depth and normal, side by side.
const SHAPE: usize = 4;
/// Those of all pixels, then their colours' bits.
const TILE: usize = PIXELS * (SHAPE + 1);
/// No place, no frame.
const NONE: u32 = u32::MAX;

/// Bytes that clustering keeps of one pixel, its tile's share.
pub const CLUSTER_BYTES: usize = size_of::<f32>() * TILE / PIXELS;

/// What clustering asks of a pixel that has a depth.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Pixel {
    pub(super) depth: f64,
    /// In the world; zero where there is none.
    pub(super) normal: Vec3,
}

/// A view's tiles, ready to be kept.
pub(super) struct Packed {
    /// For every tile, row-major, its place among those with a depth, or [`NONE`].
    places: Vec<u32>,
    tiles: Vec<Vec<f32>>,
}

/// Tiles per row of a map of this width.
fn across(width: usize) -> usize {
    width.div_ceil(EDGE)
}

impl Packed {
    /// The filtered depths of the view at `index`, their normals and colours.
    pub(super) fn new(
        maps: &dyn DepthMaps,
        index: usize,
        options: &FuseOptions,
        columns: Columns,
    ) -> Result<(Self, super::FuseCounts)> {
        let view = maps.view(index);
        let samples = prepare(maps, index, options, Filters::All)?;
        let normals = maps.normals(index)?;
        let size = (view.camera.width(), view.camera.height());
        if normals.as_ref().is_some_and(|map| map.size() != size) {
            let problem = "expected normals of the depth map's size";
            return Err(Error::invalid(format!("view {}", view.id), problem));
        }
        let image = match columns.has(Columns::COLORS) {
            true => maps.image(index)?,
            false => None,
        };
        let left_out = samples.left_out();
        let source = Source {
            view,
            samples,
            normals,
            image,
            similar: options.similar_depth,
        };
        Ok((source.packed(), left_out))
    }
}

/// What a view's tiles are made from.
struct Source<'a> {
    view: &'a View,
    samples: Samples,
    normals: Option<NormalMap>,
    image: Option<ColorImage>,
    similar: f64,
}

impl Source<'_> {
    fn packed(&self) -> Packed {
        let (width, height) = (self.samples.width(), self.samples.height());
        let mut packed = Packed {
            places: Vec::new(),
            tiles: Vec::new(),
        };
        for top in (0..height).step_by(EDGE) {
            for left in (0..width).step_by(EDGE) {
                let (right, bottom) = ((left + EDGE).min(width), (top + EDGE).min(height));
                let mut rows = (top..bottom).map(|row| self.part(row, left..right));
                if rows.all(|row| row.iter().all(|&stored| stored <= 0.0)) {
                    packed.places.push(NONE);
                    continue;
                }
                packed.places.push(number(packed.tiles.len()));
                let mut tile = vec![0.0; TILE];
                for row in top..bottom {
                    for column in left..right {
                        self.put((column, row), &mut tile);
                    }
                }
                packed.tiles.push(tile);
            }
        }
        packed
    }

    /// What is stored of these columns.
    fn part(&self, row: usize, columns: Range<usize>) -> &[f32] {
        let stored = self.samples.columns();
        let (start, end) = (columns.start.max(stored.start), columns.end.min(stored.end));
        if start < end {
            self.samples.part(row, start..end)
        } else {
            &[]
        }
    }

    fn put(&self, (column, row): (usize, usize), tile: &mut [f32]) {
        let stored = self.samples.get(column, row);
        if stored <= 0.0 {
            return;
        }
        let at = within(column, row);
        let in_cam = match &self.normals {
            Some(map) => {
                let in_cam = map.get(number(column), number(row));
                normals::given(in_cam, &self.view.camera, (column, row))
            }
            None => {
                let pixel = (column, row);
                normals::from_depth(&self.samples, &self.view.camera, pixel, self.similar)
            }
        };
        let normal = in_cam.map_or(Vec3::ZERO, |normal| {
            let normal = self.view.pose.direction_to_world(normal.as_dvec3());
            normal.as_vec3()
        });
        // Never 0, which stands for none.
        let depth = self.samples.unit().convert(stored).max(f32::MIN_POSITIVE);
        let [x, y, z] = normal.to_array();
        tile[SHAPE * at..][..SHAPE].copy_from_slice(&[depth, x, y, z]);
        let [red, green, blue] = self.color(column, row);
        let bits = u32::from_le_bytes([red, green, blue, 0]);
        tile[SHAPE * PIXELS + at] = f32::from_bits(bits);
    }

    /// The colour of the image at the pixel's centre; white without an image.
    fn color(&self, column: usize, row: usize) -> [u8; 3] {
        let Some(image) = &self.image else {
            return [255; 3];
        };
        let camera = &self.view.camera;
        if image.size() == (camera.width(), camera.height()) {
            return image.get(number(column), number(row));
        }
        let scale = DVec2::new(
            f64::from(image.width()) / f64::from(camera.width()),
            f64::from(image.height()) / f64::from(camera.height()),
        );
        let pixel = DVec2::new(f64::from(number(column)), f64::from(number(row))) + 0.5;
        super::sampling::color(image, pixel * scale)
    }
}

/// A pixel's number within its tile.
fn within(column: usize, row: usize) -> usize {
    (row % EDGE) * EDGE + column % EDGE
}

fn number(index: usize) -> u32 {
    u32::try_from(index).unwrap_or(u32::MAX)
}

/// Where a tile is.
#[derive(Clone, Copy)]
struct Slot {
    /// Among the view's tiles that have a depth, or [`NONE`].
    place: u32,
    /// Among the frames, or [`NONE`].
    frame: u32,
}

/// What a tile's room holds.
struct Frame {
    /// The view and the tile.
    of: (usize, usize),
    /// Whether it was asked for since the hand passed it.
    asked: bool,
}

/// The tiles of all views: all in memory, or as many as the budget holds and the rest in the scratch.
pub(super) struct Tiles<'a> {
    scratch: &'a dyn Scratch,
    /// By view: tiles per row, and the tiles.
    maps: Vec<(usize, Vec<Slot>)>,
    frames: Vec<Frame>,
    /// By frame.
    values: Vec<Vec<f32>>,
    most: usize,
    /// The frame that goes next, unless it was asked for.
    hand: usize,
}

impl<'a> Tiles<'a> {
    /// Room for at most `memory` bytes of tiles.
    pub(super) fn new(scratch: &'a dyn Scratch, memory: usize) -> Self {
        Self {
            scratch,
            maps: Vec::new(),
            frames: Vec::new(),
            values: Vec::new(),
            most: (memory / (size_of::<f32>() * TILE)).max(1),
            hand: 0,
        }
    }

    /// Keeps the tiles of one view in the scratch.
    pub(super) fn store(scratch: &dyn Scratch, index: usize, packed: &mut Packed) -> Result<()> {
        let mut all = Vec::with_capacity(packed.tiles.len() * TILE);
        for tile in std::mem::take(&mut packed.tiles) {
            all.extend_from_slice(&tile);
        }
        scratch.store(index as u64, all)
    }

    /// Takes the next view's tiles, `width` its map's; those that are not among `packed` any more lie in
    /// the scratch.
    pub(super) fn add(&mut self, width: usize, packed: Packed) {
        let view = self.maps.len();
        let slot = |&place: &u32| Slot { place, frame: NONE };
        let mut slots: Vec<Slot> = packed.places.iter().map(slot).collect();
        let there = (0..slots.len()).filter(|&at| packed.places[at] != NONE);
        for (at, values) in there.zip(packed.tiles) {
            slots[at].frame = number(self.frames.len());
            self.frames.push(Frame {
                of: (view, at),
                asked: true,
            });
            self.values.push(values);
        }
        self.maps.push((across(width), slots));
    }

    /// The pixel of a view, if it has a depth.
    #[inline]
    pub(super) fn pixel(
        &mut self,
        view: usize,
        (column, row): (u32, u32),
    ) -> Result<Option<Pixel>> {
        let (column, row) = (column as usize, row as usize);
        let Some(values) = self.tile(view, column, row)? else {
            return Ok(None);
        };
        let shape = values[SHAPE * within(column, row)..].first_chunk::<SHAPE>();
        let [depth, x, y, z] = *shape.unwrap_or(&[0.0; SHAPE]);
        Ok((depth > 0.0).then_some(Pixel {
            depth: f64::from(depth),
            normal: Vec3::new(x, y, z),
        }))
    }

    /// The colour of a pixel that has a depth.
    pub(super) fn color(&mut self, view: usize, (column, row): (u32, u32)) -> Result<[u8; 3]> {
        let (column, row) = (column as usize, row as usize);
        let values = self.tile(view, column, row)?;
        let value = values.map_or(0.0, |values| values[SHAPE * PIXELS + within(column, row)]);
        let [red, green, blue, _] = value.to_bits().to_le_bytes();
        Ok([red, green, blue])
    }

    #[inline]
    fn tile(&mut self, view: usize, column: usize, row: usize) -> Result<Option<&[f32]>> {
        let (across, slots) = &self.maps[view];
        let at = row / EDGE * across + column / EDGE;
        let slot = slots[at];
        if slot.place == NONE {
            return Ok(None);
        }
        let frame = match slot.frame {
            NONE => self.fetch(view, at)?,
            frame => frame as usize,
        };
        self.frames[frame].asked = true;
        Ok(Some(&self.values[frame]))
    }

    /// Has the processor fetch a pixel that will be looked at, if its tile is in memory.
    #[inline]
    pub(super) fn ask(&self, view: usize, (column, row): (u32, u32)) {
        let (column, row) = (column as usize, row as usize);
        let (across, slots) = &self.maps[view];
        let frame = slots[row / EDGE * across + column / EDGE].frame;
        if let Some(values) = self.values.get(frame as usize) {
            prefetch(values, SHAPE * within(column, row));
        }
    }

    /// Puts a tile into a frame of its own, or into that of one not asked for lately.
    #[cold]
    fn fetch(&mut self, view: usize, at: usize) -> Result<usize> {
        let frame = if self.frames.len() < self.most {
            self.frames.push(Frame {
                of: (view, at),
                asked: true,
            });
            self.values.push(Vec::new());
            self.frames.len() - 1
        } else {
            self.free()
        };
        let start = self.maps[view].1[at].place as usize * TILE;
        let values = &mut self.values[frame];
        (self.scratch).fetch_part(view as u64, start..start + TILE, values)?;
        self.frames[frame].of = (view, at);
        self.maps[view].1[at].frame = number(frame);
        Ok(frame)
    }

    /// A frame whose tile has gone.
    fn free(&mut self) -> usize {
        loop {
            let at = self.hand;
            self.hand = (self.hand + 1) % self.frames.len();
            if !std::mem::take(&mut self.frames[at].asked) {
                let (view, tile) = self.frames[at].of;
                self.maps[view].1[tile].frame = NONE;
                return at;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fuse::MemoryScratch;
    use crate::fuse::testing::{Plane, arc, spoil};
    use glam::DVec3;

    #[test]
    fn pixels_come_back_whatever_room_there_is() {
        let surface = |view: &View, pixel| Plane::tilted().depth(view, pixel);
        let mut estimates = arc(3, (70, 45), DVec3::ZERO, surface);
        for (seed, estimate) in (0..).zip(&mut estimates) {
            spoil(estimate, seed, 2e-3, 0.05, 12);
            let values = (0..70 * 45).map(|at: u32| [at.to_le_bytes()[0], at.to_le_bytes()[1], 7]);
            let image = ColorImage::from_values(70, 45, values.collect());
            estimate.image = Some(image.unwrap());
        }
        let maps = estimates.as_slice();
        let options = FuseOptions::default();
        let scratch = MemoryScratch::default();
        let mut all = Tiles::new(&scratch, 0);
        let mut few = Tiles::new(&scratch, 5 * 4 * TILE);
        for index in 0..3 {
            let packed = || {
                Packed::new(&maps, index, &options, Columns::COLORS)
                    .unwrap()
                    .0
            };
            let mut stored = packed();
            Tiles::store(&scratch, index, &mut stored).unwrap();
            few.add(70, stored);
            all.add(70, packed());
        }
        let mut seen = 0;
        for step in 0..3 * 70 * 45 {
            // All pixels in a scattered order.
            let at = step * 1979 % (3 * 70 * 45);
            let (view, place) = (at / (70 * 45), at % (70 * 45));
            let pixel = ((place % 70) as u32, (place / 70) as u32);
            let found = few.pixel(view, pixel).unwrap();
            assert_eq!(found, all.pixel(view, pixel).unwrap());
            let depth = estimates[view].depth.get(pixel.0, pixel.1);
            assert_eq!(found.is_some(), depth > 0.0);
            let Some(found) = found else { continue };
            assert!((found.depth - f64::from(depth)).abs() <= 1e-6 * found.depth);
            let [low, high, _, _] = (place as u32).to_le_bytes();
            assert_eq!(few.color(view, pixel).unwrap(), [low, high, 7]);
            seen += 1;
        }
        assert!(seen > 5000 && few.frames.len() == 5, "{seen}");
    }
}
