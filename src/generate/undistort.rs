//! Photographs as a pinhole camera would have taken them: what the lens did is undone.

use super::resample::{LOBES, lanczos, to_level};
use crate::error::Result;
use crate::parallel;
use glam::{DVec2, DVec3};
use mvs_datasets::scene::{Camera, ColorImage, Raster};

/// Places between two pixels at which the kernel is tabulated.
const PHASES: usize = 1024;

/// The image of `target`, a pinhole camera, from `photograph`, which `taken_by` took at whatever
/// size; and how many of its pixels the photograph does not cover, where its border is repeated, or
/// what the lens shows last in that direction.
///
/// Lanczos with three lobes, stretched where the photograph is finer than the target.
pub(super) fn undistorted(
    photograph: &ColorImage,
    taken_by: &Camera,
    target: &Camera,
) -> Result<(ColorImage, usize)> {
    let taken_by = taken_by.resized(photograph.width(), photograph.height())?;
    let finer = taken_by.focal() / target.focal();
    let kernels = (Kernel::new(finer.x), Kernel::new(finer.y));
    let width = target.width() as usize;
    let field = taken_by.distortion().field_radius();
    let mut image = Raster::filled(target.width(), target.height(), [0u8; 3])?;
    let mut beyond = vec![0usize; target.height() as usize];
    parallel::for_each_chunk(image.values_mut(), width, |row, out| {
        for (column, value) in out.iter_mut().enumerate() {
            let centre = DVec2::new(column as f64 + 0.5, row as f64 + 0.5);
            if let Some(at) = nearest(&taken_by, field, target.ray(centre)) {
                *value = sample(photograph, (&kernels.0, &kernels.1), at);
            }
        }
    });
    parallel::for_each_chunk(&mut beyond, 1, |row, count| {
        let covered = |&column: &usize| {
            let centre = DVec2::new(column as f64 + 0.5, row as f64 + 0.5);
            let at = taken_by.project(target.ray(centre));
            at.is_some_and(|at| taken_by.contains(at))
        };
        count[0] = width - (0..width).filter(covered).count();
    });
    Ok((image, beyond.iter().sum()))
}

/// Where `ray` falls, or the ray in its direction at the edge of the lens's field, `field` wide at
/// depth 1: further out the lens shows nothing.
fn nearest(camera: &Camera, field: f64, ray: DVec3) -> Option<DVec2> {
    camera.project(ray).or_else(|| {
        let ideal = ray.truncate() / ray.z;
        let edge = ideal * (field * (1.0 - 1e-9) / ideal.length());
        camera.project(edge.extend(1.0))
    })
}

/// Weights of the pixels around a place, by how far it lies behind a pixel's centre.
struct Kernel {
    /// Pixels on either side.
    reach: i64,
    /// 2 · reach weights for each phase.
    weights: Vec<f32>,
}

impl Kernel {
    fn new(finer: f64) -> Self {
        let stretch = finer.max(1.0);
        let reach = (LOBES * stretch).ceil();
        let taps = 2 * reach as usize;
        let mut weights = Vec::with_capacity(PHASES * taps);
        for phase in 0..PHASES {
            let behind = (phase as f64 + 0.5) / PHASES as f64;
            // The first of the pixels lies reach − 1 before the one at or before the place.
            let weight = |tap: usize| lanczos((tap as f64 + 1.0 - reach - behind) / stretch);
            let sum: f64 = (0..taps).map(weight).sum();
            weights.extend((0..taps).map(|tap| (weight(tap) / sum) as f32));
        }
        Self {
            reach: reach as i64,
            weights,
        }
    }

    /// The index of the first pixel around continuous coordinate `at`, and the pixels' weights.
    fn around(&self, at: f64) -> (i64, &[f32]) {
        let from_centre = at - 0.5;
        let base = from_centre.floor();
        let phase = ((from_centre - base) * PHASES as f64) as usize;
        let taps = 2 * self.reach as usize;
        let start = phase.min(PHASES - 1) * taps;
        (
            base as i64 + 1 - self.reach,
            &self.weights[start..start + taps],
        )
    }
}

fn sample(photograph: &ColorImage, kernels: (&Kernel, &Kernel), at: DVec2) -> [u8; 3] {
    let (first_column, columns) = kernels.0.around(at.x);
    let (first_row, rows) = kernels.1.around(at.y);
    let (width, height) = (photograph.width(), photograph.height());
    let inside = |index: i64, length: u32| index.clamp(0, i64::from(length) - 1) as usize;
    let mut sums = [0.0f32; 3];
    for (row, by_row) in (first_row..).zip(rows) {
        let start = inside(row, height) * width as usize;
        let mut along = [0.0f32; 3];
        for (column, by_column) in (first_column..).zip(columns) {
            let pixel = photograph.values()[start + inside(column, width)];
            for channel in 0..3 {
                along[channel] += by_column * f32::from(pixel[channel]);
            }
        }
        for channel in 0..3 {
            sums[channel] += by_row * along[channel];
        }
    }
    sums.map(to_level)
}

#[cfg(test)]
mod tests {
    use super::super::resample;
    use super::*;
    use mvs_datasets::scene::Distortion;

    fn pinhole(width: u32, height: u32, focal: f64) -> Camera {
        let center = DVec2::new(f64::from(width) / 2.0 + 1.3, f64::from(height) / 2.0 - 0.7);
        Camera::new(width, height, DVec2::splat(focal), center).unwrap()
    }

    fn barrel() -> Distortion {
        Distortion::RadialTangential {
            radial: [-0.2, 0.05, 0.0, 0.0, 0.0, 0.0],
            tangential: [0.002, -0.001],
        }
    }

    /// A smooth picture of the directions: what any camera sees is known.
    fn scene(x: f64, y: f64) -> [u8; 3] {
        let wave = |t: f64| (127.0 + 100.0 * t.sin()).round() as u8;
        [wave(12.0 * x), wave(9.0 * y), wave(7.0 * (x + y))]
    }

    fn taken(camera: &Camera) -> ColorImage {
        let mut image = ColorImage::filled(camera.width(), camera.height(), [0; 3]).unwrap();
        for row in 0..camera.height() {
            for column in 0..camera.width() {
                let ray = camera.ray(DVec2::new(f64::from(column) + 0.5, f64::from(row) + 0.5));
                image.set(column, row, scene(ray.x, ray.y));
            }
        }
        image
    }

    #[test]
    fn a_photograph_through_a_lens_is_what_the_pinhole_camera_sees() {
        for (photo, scale) in [((320, 240), 1), ((640, 480), 2)] {
            let bent = pinhole(320, 240, 250.0).with_distortion(barrel()).unwrap();
            let photograph = taken(&bent.resized(photo.0, photo.1).unwrap());
            let target = pinhole(320, 240, 250.0);
            let (found, beyond) = undistorted(&photograph, &bent, &target).unwrap();
            assert_eq!(beyond, 0, "a barrel lens sees more than the pinhole");
            let expected = taken(&target);
            let mut worst = 0;
            for (f, e) in found.values().iter().zip(expected.values()) {
                worst = worst.max((0..3).map(|c| f[c].abs_diff(e[c])).max().unwrap());
            }
            // Rounding to levels twice, and the kernel's own ripple.
            assert!(worst <= 2, "scale {scale}: {worst}");
        }
    }

    #[test]
    fn without_a_lens_it_is_plain_resampling() {
        let camera = pinhole(120, 90, 100.0);
        let photograph = taken(&pinhole(120, 90, 100.0).resized(240, 180).unwrap());
        let (found, _) = undistorted(&photograph, &camera, &camera).unwrap();
        let expected = resample::resized(&photograph, (120, 90)).unwrap();
        for row in 4..86 {
            for column in 4..116 {
                let (f, e) = (found.get(column, row), expected.get(column, row));
                assert!((0..3).all(|c| f[c].abs_diff(e[c]) <= 1), "{f:?} {e:?}");
            }
        }
    }

    #[test]
    fn beyond_the_field_of_a_barrel_lens_its_last_colour_is_repeated() {
        let barrel = Distortion::RadialTangential {
            radial: [-0.3, 0.0, 0.0, 0.0, 0.0, 0.0],
            tangential: [0.0; 2],
        };
        // r (1 - 0.3 r²) grows to r = 1.054, the corner lies at 1.28.
        let camera = pinhole(200, 160, 100.0).with_distortion(barrel).unwrap();
        let photograph = ColorImage::filled(200, 160, [40, 50, 60]).unwrap();
        let target = pinhole(200, 160, 100.0);
        let corner = target.ray(DVec2::new(0.5, 159.5));
        assert_eq!(camera.project(corner), None);
        let (found, beyond) = undistorted(&photograph, &camera, &target).unwrap();
        assert!(beyond > 100, "{beyond}");
        assert!(found == photograph, "black where the lens ends");
    }

    #[test]
    fn what_the_photograph_does_not_show_is_counted_and_filled_from_its_border() {
        let pincushion = Distortion::RadialTangential {
            radial: [0.3, 0.0, 0.0, 0.0, 0.0, 0.0],
            tangential: [0.0; 2],
        };
        let camera = pinhole(100, 80, 60.0).with_distortion(pincushion).unwrap();
        let photograph = ColorImage::filled(100, 80, [40, 50, 60]).unwrap();
        let (found, beyond) = undistorted(&photograph, &camera, &pinhole(100, 80, 60.0)).unwrap();
        assert!(beyond > 100 && beyond < 6000, "{beyond}");
        assert_eq!(found, photograph);
    }
}
