//! Triangles as they are painted, kept while they are in use.

use super::doubles::FOUR;
use super::lanes::Lanes;
use super::surface::{Paint, Patch};
use super::texture::Texels;
use super::tile::NONE;
use glam::DVec3;

/// Slots of the memory of triangles that have been met.
const SLOTS: usize = 1024;
/// Brushes that are kept at most, but for those of one row or tile.
const MOST: usize = 2048;

/// A triangle as it is painted.
pub(super) struct Brush {
    /// By x, by y and as they are: the parts of the normal's share, of both places', and of the volume, as
    /// [`Patch`] has them.
    pub(super) axes: [[f64; FOUR]; 3],
    pub(super) kind: Kind,
}

/// What is painted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Kind {
    /// No surface.
    Nothing,
    /// A texture that ends at its border: its place among those that were met.
    Texture(u32),
    /// Anything else, in the same way.
    Paint(u32),
    /// Not all the same.
    Several,
}

impl Brush {
    const NONE: Self = Self {
        axes: [[0.0; FOUR]; 3],
        kind: Kind::Nothing,
    };

    fn new(patch: &Patch<'_>, kind: Kind) -> Self {
        let axes = |part: fn(DVec3) -> f64, volume: f64| {
            [part(patch.normal), part(patch.x), part(patch.y), volume]
        };
        Self {
            axes: [
                axes(|axis| axis.x, 0.0),
                axes(|axis| axis.y, 0.0),
                axes(|axis| axis.z, patch.volume),
            ],
            kind,
        }
    }
}

/// The brushes of triangles that were met.
pub(super) struct Palette<'m> {
    /// The first stands for none.
    brushes: Vec<Brush>,
    textures: Vec<Texels<'m>>,
    paints: Vec<Paint<'m>>,
    /// Triangles met of late, by their number, with their place in `brushes`.
    met: [(u32, u32); SLOTS],
}

impl<'m> Palette<'m> {
    pub(super) fn new() -> Self {
        Self {
            brushes: vec![Brush::NONE],
            textures: Vec::new(),
            paints: Vec::new(),
            met: [(NONE, 0); SLOTS],
        }
    }

    /// Begins again where too many brushes are kept. Places of before mean nothing then.
    #[inline(always)]
    pub(super) fn tidy(&mut self) {
        if self.brushes.len() > MOST {
            self.empty();
        }
    }

    #[cold]
    #[inline(never)]
    fn empty(&mut self) {
        self.brushes.truncate(1);
        self.textures.clear();
        self.paints.clear();
        self.met = [(NONE, 0); SLOTS];
    }

    /// Where a triangle's brush is, or that of none.
    #[inline(always)]
    pub(super) fn place(&mut self, id: u32, make: impl FnOnce() -> Patch<'m>) -> u32 {
        // None is met from the start.
        let (known, place) = self.met[id as usize % SLOTS];
        if id == NONE {
            0
        } else if known == id {
            place
        } else {
            self.take(id, &make())
        }
    }

    /// Takes a triangle in.
    #[inline(never)]
    fn take(&mut self, id: u32, patch: &Patch<'m>) -> u32 {
        #[allow(clippy::cast_possible_truncation, reason = "some thousand at most")]
        let number = |count: usize| count as u32;
        let kind = match &patch.paint {
            _ if patch.back => Kind::Nothing,
            Paint::Texture(texels, _) if !texels.repeats() => {
                let met = self.textures.iter().rposition(|met| met.is(texels));
                let place = met.unwrap_or_else(|| {
                    self.textures.push(*texels);
                    self.textures.len() - 1
                });
                Kind::Texture(number(place))
            }
            Paint::Texture(..) | Paint::Tinted(..) | Paint::Light(_) | Paint::Linear(_) => {
                self.paints.push(patch.paint);
                Kind::Paint(number(self.paints.len() - 1))
            }
        };
        let place = number(self.brushes.len());
        self.brushes.push(Brush::new(patch, kind));
        self.met[id as usize % SLOTS] = (id, place);
        place
    }

    #[inline(always)]
    pub(super) fn brush(&self, place: u32) -> &Brush {
        &self.brushes[place as usize]
    }

    #[inline(always)]
    pub(super) fn texture(&self, place: u32) -> &Texels<'m> {
        &self.textures[place as usize]
    }

    /// The colour at a place, as [`Paint::color`]; `None` where there is no surface.
    #[inline(always)]
    pub(super) fn color<L: Lanes>(&self, l: L, kind: Kind, at: [f64; 2]) -> Option<L::V> {
        match kind {
            Kind::Nothing | Kind::Several => None,
            Kind::Texture(place) => Some(self.texture(place).color_at(l, at)),
            Kind::Paint(place) => Some(self.paints[place as usize].color(l, at)),
        }
    }
}
