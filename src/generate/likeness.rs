//! Whether a photograph shows what its view's rendering shows: brightness, tile by tile.
//!
//! Means over a view's tiles, from the least view to the likest: .56 to .93 on the real scene (768x576), .90 to
//! 1.00 on the demo's and on five fixture scenes of 96x72 to 768x576 pixels, .33 to .48 where the real renderings are
//! blurred by 32 pixels, as a mesh of few colours would be. With the photograph of the next view or the one after it
//! at most .20 on the real scene and .28 on fixtures of 96x72; mirrored or turned at most .07 and .18; from a mesh
//! that is 3 % too large and moved -.02 to .18; moved by two pixels .40 to .60, by four .25 to .32. Images of fewer
//! than 200 pixels leave neighbouring views alike, so that of their wrong photographs some stay unnoticed.

use crate::warning::Warning;
use mvs_datasets::scene::{ColorImage, Mask};

/// A photograph that is less like its rendering is another view's: between the likest that are wrong and the least
/// that are right, nearer to the former.
const UNLIKE: f64 = 0.25;
/// Tiles are so many cells wide and high.
const TILE: usize = 8;
/// The longer side of an image has about so many cells, of whole pixels.
const CELLS: u32 = 256;
/// A tile counts where so many of its 64 cells show surface, and the rendering varies by so many grey levels
/// (standard deviation): what varies less may be noise in the photograph.
const SHOWN: i64 = 48;
const CONTRAST: f64 = 4.0;
/// Fewer tiles say nothing of a view.
const FEW: usize = 16;

/// The mean over tiles of the correlation of brightness between rendering and photograph, -1 to 1; `None` where
/// too few tiles of the rendering show texture. A tile in which the photograph is flat counts 0. Light that varies
/// little within a tile (a thirtieth of the image's longer side) does not move it. All three must have one size. Of
/// each cell one row of pixels is read: .2 ms for 768x576 pixels, a five-hundredth of what the view takes.
pub(crate) fn likeness(
    rendering: &ColorImage,
    photograph: &ColorImage,
    mask: &Mask,
) -> Option<f64> {
    let (width, height) = mask.size();
    let cell = (width.max(height) / CELLS).max(1) as usize;
    let tiles_of = |pixels: u32| pixels as usize / (cell * TILE);
    let (mut sum, mut count) = (0.0, 0);
    for row in 0..tiles_of(height) {
        for column in 0..tiles_of(width) {
            let sums = Sums::of((rendering, photograph, mask), (column, row), cell);
            if let Some(found) = sums.correlation(cell) {
                sum += found;
                count += 1;
            }
        }
    }
    (count >= FEW).then(|| sum / count as f64)
}

/// Whether a photograph so like its rendering is another view's.
pub(crate) fn is_unlike(likeness: Option<f64>) -> bool {
    likeness.is_some_and(|found| found < UNLIKE)
}

/// Whether not even a mesh of very coarse colours explains it: averaged over a seventeenth of the real scene they
/// leave .18 and more.
pub(crate) fn is_surely_unlike(likeness: f64) -> bool {
    likeness < 0.5 * UNLIKE
}

/// A warning that names the worst of these photographs (name, likeness) where any is another view's.
pub(crate) fn warning_of_unlike<N: std::fmt::Display>(
    all: impl Iterator<Item = (N, Option<f64>)> + Clone,
) -> Option<Warning> {
    let unlike = (all.clone()).filter_map(|(name, found)| {
        let found = found.filter(|_| is_unlike(found))?;
        Some((name, found))
    });
    let (name, worst) = unlike.clone().min_by(|a, b| a.1.total_cmp(&b.1))?;
    let message = format!(
        "{} of {} photographs do not show what their renderings show; the worst is that of {name}: \
         {}",
        unlike.count(),
        all.count(),
        explained(worst)
    );
    Some(Warning::new(CODE, message))
}

/// The code of the warning, and of what `verify` finds.
pub(crate) const CODE: &str = "photograph-does-not-match";

/// What such a likeness means.
pub(crate) fn explained(likeness: f64) -> String {
    format!(
        "their brightness correlates by {likeness:.2}, where sound ones have .5 and more, .3 with colours of vertices; \
         it is that of another view, turned, mirrored or of another lens, or the mesh does not fit the cameras, or \
         its colours are very coarse"
    )
}

/// Sums over the cells of a tile that show surface: of their brightness in the rendering and in the photograph.
#[derive(Default)]
struct Sums {
    count: i64,
    rendered: i64,
    taken: i64,
    rendered_squared: i64,
    taken_squared: i64,
    product: i64,
}

impl Sums {
    fn of(
        (rendering, photograph, mask): (&ColorImage, &ColorImage, &Mask),
        (column, row): (usize, usize),
        cell: usize,
    ) -> Self {
        let brightness = |image: &ColorImage, at: usize| {
            let levels = image.values()[at..at + cell].as_flattened();
            i64::from(levels.iter().map(|&level| u32::from(level)).sum::<u32>())
        };
        let mut sums = Self::default();
        for down in 0..TILE {
            let line = (row * TILE + down) * cell + cell / 2;
            let start = line * mask.width() as usize + column * TILE * cell;
            for at in (start..start + TILE * cell).step_by(cell) {
                if mask.values()[at..at + cell].iter().all(|&inside| inside) {
                    sums.add(brightness(rendering, at), brightness(photograph, at));
                }
            }
        }
        sums
    }

    fn add(&mut self, rendered: i64, taken: i64) {
        self.count += 1;
        self.rendered += rendered;
        self.taken += taken;
        self.rendered_squared += rendered * rendered;
        self.taken_squared += taken * taken;
        self.product += rendered * taken;
    }

    /// `None` where the tile says nothing.
    fn correlation(&self, cell: usize) -> Option<f64> {
        // Times the count squared and the levels that a cell sums up, 3 · cell, squared.
        let varies = self.rendered_squared * self.count - self.rendered.pow(2);
        let taken = self.taken_squared * self.count - self.taken.pow(2);
        let shared = self.product * self.count - self.rendered * self.taken;
        let level = self.count as f64 * 3.0 * cell as f64;
        if self.count < SHOWN || (varies as f64).sqrt() < CONTRAST * level {
            return None;
        }
        if taken == 0 {
            return Some(0.0);
        }
        Some(shared as f64 / (varies as f64 * taken as f64).sqrt())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::render::{RenderOptions, Renderer};
    use mvs_datasets::synthetic::{SyntheticOptions, SyntheticScene};

    fn image(size: (u32, u32), level: impl Fn(u32, u32) -> u8) -> ColorImage {
        let places = (0..size.0 * size.1).map(|at| (at % size.0, at / size.0));
        let values = places.map(|(column, row)| [level(column, row); 3]);
        ColorImage::from_values(size.0, size.1, values.collect()).unwrap()
    }

    #[test]
    fn likeness_by_hand() {
        let size = (512, 256); // cells of 2 pixels, 32 x 16 tiles of 16
        let all = Mask::filled(size.0, size.1, true).unwrap();
        let of = |first: &ColorImage, second: &ColorImage| likeness(first, second, &all);
        let close = |found: Option<f64>, expected: f64| (found.unwrap() - expected).abs() < 1e-12;
        // Stripes two cells wide, brighter to the right: what all of a tile has is no matter.
        let stripes = |part: u32| move |x: u32, _: u32| (x / 16 * 3 + x / 4 % 2 * part) as u8;
        let crossed = |_: u32, y: u32| (y / 4 % 2 * 40) as u8;
        let rendered = image(size, stripes(40));
        assert!(close(of(&rendered, &rendered), 1.0));
        assert!(close(of(&rendered, &image(size, stripes(7))), 1.0));
        assert!(close(
            of(&rendered, &image(size, |x, y| 255 - stripes(40)(x, y))),
            -1.0
        ));
        assert!(close(of(&rendered, &image(size, crossed)), 0.0));
        assert!(
            close(of(&rendered, &image(size, |_, _| 90)), 0.0),
            "a flat photograph"
        );
        // Half of the tiles show another thing.
        let half = image(size, |x, y| {
            if y < 128 {
                stripes(40)(x, y)
            } else {
                crossed(x, y)
            }
        });
        assert!(close(of(&rendered, &half), 0.5));
        // The rendering varies by 3.5 levels, or is shown too little.
        assert_eq!(of(&image(size, stripes(7)), &rendered), None);
        let shown = |tiles: u32| {
            let inside = (0..512 * 256u32).map(|at| at % 512 < 16 * tiles && at / 512 < 16);
            Mask::from_values(512, 256, inside.collect()).unwrap()
        };
        assert_eq!(likeness(&rendered, &rendered, &shown(15)), None);
        assert!(close(likeness(&rendered, &rendered, &shown(16)), 1.0));
    }

    #[test]
    fn right_photographs_of_all_fixtures_are_told_from_those_of_the_next_view() {
        for (name, options) in SyntheticOptions::fixtures() {
            let scene = SyntheticScene::new(options).unwrap();
            let renderer = Renderer::new(scene.mesh()).unwrap();
            let views = scene.scene().views();
            let shown = |index: usize| {
                renderer
                    .render(&views[index], &RenderOptions::default())
                    .unwrap()
            };
            let shown = [shown(0), shown(1)];
            let photographs = [0, 1].map(|index| scene.photograph(index, &shown[index].color));
            let of = |view: usize, photograph: usize| {
                let mask = shown[view].depth.valid_mask();
                likeness(&shown[view].color, &photographs[photograph], &mask)
            };
            for (own, other) in [(0, 1), (1, 0)] {
                let (right, wrong) = (of(own, own), of(own, other));
                assert!(
                    right.unwrap() > 0.9 && !is_unlike(right),
                    "{name}: {right:?}"
                );
                assert!(
                    wrong.unwrap() < 0.2 && is_unlike(wrong),
                    "{name}: {wrong:?}"
                );
            }
        }
    }

    #[test]
    fn one_warning_names_the_worst_of_all_that_are_unlike() {
        let all = [
            ("a", Some(0.9)),
            ("b", None),
            ("c", Some(0.2)),
            ("d", Some(-0.1)),
        ];
        let warning = warning_of_unlike(all.into_iter()).unwrap();
        assert_eq!(warning.code, "photograph-does-not-match");
        let said = &warning.message;
        assert!(
            said.starts_with("2 of 4 photographs") && said.contains("that of d"),
            "{said}"
        );
        assert_eq!(warning_of_unlike(all[..2].iter().copied()), None);
    }

    #[test]
    fn what_coarse_colours_could_explain_is_not_sure() {
        assert!(is_surely_unlike(-0.3) && is_surely_unlike(0.1) && !is_surely_unlike(0.2));
        assert!(is_unlike(Some(0.2)) && !is_unlike(Some(0.3)) && !is_unlike(None));
    }
}
