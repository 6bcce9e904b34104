//! What a view's pixels show of other views' sight, and where its depth jumps.

use super::pairs::{self, SurfacePoint};
use crate::error::{Error, Result};
use crate::parallel;
use crate::render::{Renderer, Rendering};
use glam::{DVec2, DVec3};
use mvs_datasets::scene::{DepthMap, Mask, NormalMap, Raster, View};
use std::ops::Range;

/// No surface, or outside the source's image.
pub const OUTSIDE: u8 = 0;
/// Inside the source's image, but hidden from it or facing away.
pub const OCCLUDED: u8 = 128;
/// Seen by the source.
pub const VISIBLE: u8 = 255;

/// For each pixel of `view`, rendered as `rendering`: whether `source` sees its surface. Values
/// [`OUTSIDE`], [`OCCLUDED`], [`VISIBLE`]. The rendering must have normals.
///
/// # Errors
/// A rendering without normals.
pub fn occlusion(
    renderer: &Renderer,
    (view, rendering): (&View, &Rendering),
    source: &View,
) -> Result<Raster<u8>> {
    let (width, height) = rendering.depth.size();
    let missing = || Error::invalid("rendering", "expected normals, found none");
    let normals = rendering.normals.as_ref().ok_or_else(missing)?;
    let maps = (&rendering.depth, normals);
    let bands = parallel::map(height.div_ceil(BAND) as usize, |band| {
        let first = BAND * band as u32;
        let rows = first..height.min(first + BAND);
        seen(renderer, (view, maps), source, rows)
    });
    let values = bands.into_iter().flatten().collect();
    Ok(Raster::from_values(width, height, values)?)
}

/// Rows that are worked out together.
const BAND: u32 = 8;

/// The pixels of some rows.
fn seen(
    renderer: &Renderer,
    (view, (depth, normals)): (&View, (&DepthMap, &NormalMap)),
    source: &View,
    rows: Range<u32>,
) -> Vec<u8> {
    let (width, _) = depth.size();
    let mut values = vec![OUTSIDE; rows.len() * width as usize];
    let (mut places, mut points) = (Vec::new(), Vec::new());
    let pixels = rows.flat_map(|row| (0..width).map(move |column| (column, row)));
    for (place, (column, row)) in pixels.enumerate() {
        let depth = f64::from(depth.get(column, row));
        if depth == 0.0 {
            continue;
        }
        let pixel = DVec2::new(f64::from(column) + 0.5, f64::from(row) + 0.5);
        let position = view.pose.to_world(depth * view.camera.ray(pixel));
        if pairs::in_frame(source, position) {
            let normal = normals.get(column, row).map(f64::from);
            let normal = view.pose.direction_to_world(DVec3::from_array(normal));
            places.push(place);
            points.push(SurfacePoint { position, normal });
        }
    }
    for (place, seen) in places
        .into_iter()
        .zip(pairs::unoccluded(renderer, source, &points))
    {
        values[place] = if seen { VISIBLE } else { OCCLUDED };
    }
    values
}

/// Pixels on either side of a jump: a neighbour (of four) has no depth, or one that differs by more
/// than `jump` of the nearer one.
///
/// # Errors
/// Never, for maps of fewer than 2³² pixels.
pub fn depth_edges(depth: &DepthMap, jump: f32) -> Result<Mask> {
    let (width, height) = depth.size();
    let is_edge = |index: u32| {
        let (column, row) = (index % width, index / width);
        let here = depth.get(column, row);
        let differs = |there: f32| {
            (here > 0.0 || there > 0.0) && (here - there).abs() > jump * here.min(there)
        };
        (column > 0 && differs(depth.get(column - 1, row)))
            || (column + 1 < width && differs(depth.get(column + 1, row)))
            || (row > 0 && differs(depth.get(column, row - 1)))
            || (row + 1 < height && differs(depth.get(column, row + 1)))
    };
    let values = (0..width * height).map(is_edge).collect();
    Ok(Raster::from_values(width, height, values)?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::render::RenderOptions;
    use mvs_datasets::scene::{Camera, Mesh, Pose};

    fn view(eye: DVec3) -> View {
        View {
            id: 0,
            name: String::new(),
            camera: Camera::new(60, 40, DVec2::splat(60.0), DVec2::new(30.0, 20.0)).unwrap(),
            pose: Pose::looking_at(eye, DVec3::ZERO, DVec3::Y).unwrap(),
            depth_range: None,
        }
    }

    fn square(center: DVec3, half: f64) -> [DVec3; 4] {
        [(-1.0, -1.0), (-1.0, 1.0), (1.0, 1.0), (1.0, -1.0)]
            .map(|(x, y)| center + half * DVec3::new(x, y, 0.0))
    }

    /// A wall at z = 0 and a small screen before it.
    fn mesh() -> Mesh {
        let mut vertices = square(DVec3::ZERO, 20.0).to_vec();
        vertices.extend(square(DVec3::new(0.0, 0.0, -5.0), 0.5));
        let triangles = vec![[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]];
        Mesh::new(vertices, triangles).unwrap()
    }

    /// By the closed form: the wall's point and the source's eye meet the screen's plane, or not.
    fn expected(position: DVec3, source: &View) -> u8 {
        if !pairs::in_frame(source, position) {
            return OUTSIDE;
        }
        let eye = source.pose.center_in_world();
        let at = position + (eye - position) * ((-5.0 - position.z) / (eye.z - position.z));
        let behind_screen = position.z > -4.9 && at.x.abs() < 0.5 && at.y.abs() < 0.5;
        if behind_screen { OCCLUDED } else { VISIBLE }
    }

    #[test]
    fn a_screen_hides_what_the_closed_form_says() {
        let mesh = mesh();
        let renderer = Renderer::new(&mesh).unwrap();
        let (reference, source) = (
            view(DVec3::new(1.0, 0.3, -10.0)),
            view(DVec3::new(-2.0, 0.5, -9.0)),
        );
        let options = RenderOptions {
            samples: 1,
            ..RenderOptions::default()
        };
        let rendering = renderer.render(&reference, &options).unwrap();
        let found = occlusion(&renderer, (&reference, &rendering), &source).unwrap();
        let mut counts = [0; 3];
        for row in 0..40 {
            for column in 0..60 {
                let pixel = DVec2::new(f64::from(column) + 0.5, f64::from(row) + 0.5);
                let depth = f64::from(rendering.depth.get(column, row));
                let position = reference.pose.to_world(depth * reference.camera.ray(pixel));
                let value = expected(position, &source);
                assert_eq!(found.get(column, row), value, "{column} {row}");
                counts[usize::from(value / 127)] += 1;
            }
        }
        assert!(counts.iter().all(|&count| count > 20), "{counts:?}");
    }

    #[test]
    fn a_wall_seen_from_behind_is_occluded() {
        let vertices = square(DVec3::ZERO, 20.0).to_vec();
        let mesh = Mesh::new(vertices, vec![[0, 1, 2], [0, 2, 3]]).unwrap();
        let renderer = Renderer::new(&mesh).unwrap();
        let (front, behind) = (
            view(DVec3::new(0.0, 0.0, -9.0)),
            view(DVec3::new(0.0, 0.1, 9.0)),
        );
        let rendering = renderer.render(&front, &RenderOptions::default()).unwrap();
        let found = occlusion(&renderer, (&front, &rendering), &behind).unwrap();
        assert!(!found.values().contains(&VISIBLE));
        assert!(found.values().contains(&OCCLUDED));
    }

    #[test]
    fn edges_stand_on_both_sides_of_a_jump_and_not_on_slopes() {
        let row = vec![1.0, 1.01, 1.02, 1.5, 1.51, 0.0, 0.0];
        let depth = DepthMap::from_values(7, 1, row).unwrap().0;
        let edges = depth_edges(&depth, 0.02).unwrap();
        assert_eq!(
            edges.values(),
            [false, false, true, true, true, true, false]
        );
    }
}
