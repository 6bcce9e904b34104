//! Which views see the same surface, and under which angle: source views and co-visibility.

use crate::error::{Error, Result};
use crate::parallel;
use crate::progress::Progress;
use crate::render::{BackFaces, Renderer};
use glam::{DVec2, DVec3};
use mvs_datasets::scene::{Mesh, SourceScore, View};
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;

/// How source views are chosen.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PairOptions {
    /// Points looked at per view: about this many on a regular grid over the image.
    pub points: u32,
    /// The angle between two lines of sight that is best, in degrees.
    pub best_angle: f64,
    /// Standard deviation in degrees below the best angle.
    pub sigma_below: f64,
    /// Standard deviation in degrees above the best angle.
    pub sigma_above: f64,
    /// Source views per view, at most.
    pub sources: usize,
}

impl Default for PairOptions {
    /// The weights of MVSNet's view selection, and its ten source views.
    fn default() -> Self {
        Self {
            points: 3072,
            best_angle: 5.0,
            sigma_below: 1.0,
            sigma_above: 10.0,
            sources: 10,
        }
    }
}

impl PairOptions {
    pub(super) fn check(&self) -> Result<()> {
        let sigmas = [self.sigma_below, self.sigma_above];
        if self.points == 0 || self.sources == 0 {
            let problem = "expected at least 1 point and 1 source view per view, found 0";
            return Err(Error::invalid("view selection", problem));
        }
        if !self.best_angle.is_finite() || sigmas.iter().any(|s| !(s.is_finite() && *s > 0.0)) {
            let problem = format!(
                "expected a finite angle and standard deviations above 0 degrees, found {}, {} and {}",
                self.best_angle, self.sigma_below, self.sigma_above
            );
            return Err(Error::invalid("view selection", problem));
        }
        Ok(())
    }

    /// The weight of a point seen by two cameras under `angle` degrees.
    pub fn weight(&self, angle: f64) -> f64 {
        let sigma = if angle <= self.best_angle {
            self.sigma_below
        } else {
            self.sigma_above
        };
        libm::exp(-(angle - self.best_angle).powi(2) / (2.0 * sigma * sigma))
    }
}

/// References whose surface points are looked at together, if each has no more of them than by default: what is
/// worked out about them takes some 15 MB on each thread.
const TOGETHER: usize = 32;

/// What each view sees of what the others see. Square tables, row = reference view.
#[derive(Debug, Clone, PartialEq)]
pub struct Covisibility {
    views: usize,
    /// Per mille: weighted points of the reference seen by the other, of all its grid points.
    scores: Vec<f64>,
    /// Fraction of the reference's surface points that the other sees.
    shared: Vec<f32>,
}

/// A point of the surface as one view sees it.
#[derive(Debug, Clone, Copy)]
pub(super) struct SurfacePoint {
    /// In the world.
    pub(super) position: DVec3,
    /// Unit normal on the side that the view sees.
    pub(super) normal: DVec3,
}

impl Covisibility {
    /// Looks from every view at a grid of surface points and from every other view at those.
    ///
    /// A point counts for another view when it projects inside that view's image, faces it, and no
    /// surface stands between.
    ///
    /// # Errors
    /// Options without a point or a source view, an angle that is not finite, a standard deviation that is not finite
    /// and above 0, and interruption.
    pub fn measure(
        (renderer, mesh): (&Renderer, &Mesh),
        views: &[View],
        (options, back_faces): (&PairOptions, BackFaces),
        progress: &dyn Progress,
    ) -> Result<Self> {
        options.check()?;
        let count = views.len();
        let default = PairOptions::default().points;
        let fewer = u64::from(default) * TOGETHER as u64 / u64::from(options.points);
        let together = (fewer as usize).clamp(1, TOGETHER);
        let looks = count * count.div_ceil(together);
        progress.begin("finding source views", looks as u64);
        let (mut scores, mut shared) = (vec![0.0; count * count], vec![0.0; count * count]);
        for first in (0..count).step_by(together) {
            let references = &views[first..count.min(first + together)];
            let surfaces = parallel::try_map_pieces(references.len(), |at| {
                progress.check()?;
                let look = (options, back_faces);
                Ok(surface_points((renderer, mesh), &references[at], look))
            })?;
            let columns = parallel::try_map_pieces(count, |other| {
                progress.check()?;
                let surfaces = references.iter().zip(&surfaces);
                let column = compare(renderer, surfaces, &views[other], options);
                progress.advance(1);
                Ok(column)
            })?;
            for (other, column) in columns.iter().enumerate() {
                let found = surfaces.iter().zip(column);
                for (at, ((points, looked_at), (weight, seen))) in found.enumerate() {
                    let cell = (first + at) * count + other;
                    scores[cell] = 1000.0 * weight / *looked_at as f64;
                    shared[cell] = (*seen as f64 / points.len().max(1) as f64) as f32;
                }
            }
        }
        Ok(Self {
            views: count,
            scores,
            shared,
        })
    }

    /// Number of views.
    pub fn views(&self) -> usize {
        self.views
    }

    /// The fraction of the surface seen by view `reference` that view `other` sees too; row-major.
    pub fn shared(&self) -> &[f32] {
        &self.shared
    }

    /// Whether another view sees surface that the view at `place` sees.
    pub(super) fn shares(&self, place: usize) -> bool {
        let row = &self.shared[place * self.views..][..self.views];
        (row.iter().enumerate()).any(|(other, &part)| other != place && part > 0.0)
    }

    /// Whether any two views see the same surface.
    pub(crate) fn any_share(&self) -> bool {
        (0..self.views).any(|place| self.shares(place))
    }

    /// The score of two views: the mean of both directions, rounded to 4 decimals.
    pub fn score(&self, first: usize, second: usize) -> f64 {
        let at = |row: usize, column: usize| self.scores[row * self.views + column];
        (5000.0 * (at(first, second) + at(second, first))).round() / 10_000.0
    }

    /// Source views of each view: other views with a score above 0, the best `count`, best first,
    /// equal scores by ascending id. A view without any is nobody's source either.
    pub fn sources(&self, views: &[View], count: usize) -> Vec<Vec<SourceScore>> {
        let of_view = |reference: usize| {
            let others = (0..self.views).filter(|&other| other != reference);
            let scored = others.map(|other| SourceScore {
                id: views[other].id,
                score: self.score(reference, other),
            });
            let mut sources: Vec<_> = scored.filter(|source| source.score > 0.0).collect();
            sources.sort_by(|a, b| b.score.total_cmp(&a.score).then(a.id.cmp(&b.id)));
            sources.truncate(count);
            sources
        };
        (0..self.views).map(of_view).collect()
    }
}

/// Whether a view sees surface on its grid.
pub(super) fn sees_surface(
    surface: (&Renderer, &Mesh),
    view: &View,
    look: (&PairOptions, BackFaces),
) -> bool {
    !surface_points(surface, view, look).0.is_empty()
}

/// How many views see no surface because what they see are the backs of triangles.
pub(crate) fn count_behind(
    surface: (&Renderer, &Mesh),
    views: &[View],
    (options, back_faces): (&PairOptions, BackFaces),
) -> usize {
    let sees = |view: &View, back_faces| sees_surface(surface, view, (options, back_faces));
    let behind = |view: &View| !sees(view, back_faces) && sees(view, BackFaces::Valid);
    let behind = parallel::map_pieces(views.len(), |index| behind(&views[index]));
    behind.into_iter().filter(|&behind| behind).count()
}

/// Source views of each of `views` without those in `blind`, and without views that are left without
/// any: those are nobody's source either.
pub(super) fn without(
    views: &[View],
    mut sources: Vec<Vec<SourceScore>>,
    mut blind: BTreeSet<u32>,
) -> Vec<Vec<SourceScore>> {
    loop {
        for (view, sources) in views.iter().zip(&mut sources) {
            let is_blind = blind.contains(&view.id);
            sources.retain(|source| !is_blind && !blind.contains(&source.id));
        }
        let alone = views.iter().zip(&sources).filter(|(_, all)| all.is_empty());
        let alone: BTreeSet<u32> = alone.map(|(view, _)| view.id).collect();
        if alone == blind {
            return sources;
        }
        blind = alone;
    }
}

/// More pixels of surface than this many times those between grid points are not missed by all of these.
const MISSED: f64 = 64.0;

/// The surface points that `view` sees on its grid, and how many grid points there are. Where the grid misses a
/// surface of few pixels, all pixels are its grid.
fn surface_points(
    surface: (&Renderer, &Mesh),
    view: &View,
    (options, back_faces): (&PairOptions, BackFaces),
) -> (Vec<SurfacePoint>, usize) {
    let camera = &view.camera;
    let pixels = f64::from(camera.width()) * f64::from(camera.height());
    let stride = (pixels / f64::from(options.points)).sqrt().max(1.0);
    let found = on_grid(surface, view, (stride, back_faces));
    if stride > 1.0 && found.0.is_empty() {
        let seen = surface.0.visible_count(view);
        if seen > 0 && (seen as f64) < MISSED * stride * stride {
            return on_grid(surface, view, (1.0, back_faces));
        }
    }
    found
}

fn on_grid(
    (renderer, mesh): (&Renderer, &Mesh),
    view: &View,
    (stride, back_faces): (f64, BackFaces),
) -> (Vec<SurfacePoint>, usize) {
    let camera = &view.camera;
    let steps = |length: u32| (f64::from(length) / stride).floor().max(1.0);
    let (columns, rows) = (steps(camera.width()), steps(camera.height()));
    let mut directions = Vec::new();
    for row in 0..rows as u32 {
        for column in 0..columns as u32 {
            // At pixel centres, so that a surface seen here has a depth in the rendered map.
            let centre = |index: u32, length: u32, steps: f64| {
                ((f64::from(index) + 0.5) * f64::from(length) / steps).floor() + 0.5
            };
            let pixel = DVec2::new(
                centre(column, camera.width(), columns),
                centre(row, camera.height(), rows),
            );
            directions.push(view.pose.direction_to_world(camera.ray(pixel)));
        }
    }
    let center = view.pose.center_in_world();
    let hits = renderer.first_hits(center, &directions, (0.0, f64::INFINITY));
    let points = hits.into_iter().zip(&directions);
    let points = points.filter_map(|(hit, &direction)| {
        let hit = hit.filter(|hit| !renderer.is_hollow(hit, direction, back_faces))?;
        Some(SurfacePoint {
            position: center + hit.distance * direction,
            normal: normal_towards(mesh, hit.triangle, -direction),
        })
    });
    (points.collect(), (columns * rows) as usize)
}

/// The triangle's unit normal on the side of `direction`; zero for a degenerate triangle.
pub(super) fn normal_towards(mesh: &Mesh, triangle: usize, direction: DVec3) -> DVec3 {
    let [a, b, c] = mesh.corners(triangle);
    let normal = (b - a).cross(c - a).normalize_or_zero();
    if normal.dot(direction) < 0.0 {
        -normal
    } else {
        normal
    }
}

/// The sum of weights and the number of each reference's points that `other` sees too. All their rays meet in
/// one point, and the more of them there are, the less each costs.
fn compare<'a>(
    renderer: &Renderer,
    references: impl Iterator<Item = (&'a View, &'a (Vec<SurfacePoint>, usize))>,
    other: &View,
    options: &PairOptions,
) -> Vec<(f64, usize)> {
    let (mut points, mut ends) = (Vec::new(), Vec::new());
    for (reference, (surface, _)) in references {
        let surface = surface.iter().copied();
        points.extend(surface.filter(|point| in_frame(other, point.position)));
        ends.push((reference.pose.center_in_world(), points.len()));
    }
    let unoccluded = unoccluded(renderer, other, &points);
    let center = other.pose.center_in_world();
    let mut start = 0;
    let sums = ends.into_iter().map(|(reference, end)| {
        let (mut sum, mut seen) = (0.0, 0);
        let own = points[start..end].iter().zip(&unoccluded[start..end]);
        for (point, _) in own.filter(|(_, seen)| **seen) {
            seen += 1;
            sum += options.weight(angle_at(point.position, (reference, center)));
        }
        start = end;
        (sum, seen)
    });
    sums.collect()
}

/// The angle at `point` between the two cameras, in degrees.
pub(super) fn angle_at(point: DVec3, (first, second): (DVec3, DVec3)) -> f64 {
    let (a, b) = (first - point, second - point);
    // atan2 of sine and cosine: right to the last digit at small angles, never NaN.
    libm::atan2(a.cross(b).length(), a.dot(b)).to_degrees()
}

/// How far, relative to its distance, the surface itself may stand before the point looked at.
pub(super) const SELF_TOLERANCE: f64 = 1e-5;

/// Whether `position` (world) projects inside the image.
pub(super) fn in_frame(view: &View, position: DVec3) -> bool {
    let pixel = view.camera.project(view.pose.to_cam(position));
    pixel.is_some_and(|pixel| view.camera.contains(pixel))
}

/// Whether, of each point, the normal's side faces the camera of `view` and no surface stands between.
pub(super) fn unoccluded(renderer: &Renderer, view: &View, points: &[SurfacePoint]) -> Vec<bool> {
    let center = view.pose.center_in_world();
    let lifted = |point: &SurfacePoint| {
        let direction = point.position - center;
        let lifted = direction + point.normal * (SELF_TOLERANCE * direction.length());
        (point.normal.dot(direction) < 0.0).then_some(lifted)
    };
    let lifted: Vec<Option<DVec3>> = points.iter().map(lifted).collect();
    let facing: Vec<DVec3> = lifted.iter().flatten().copied().collect();
    let mut blocked = renderer
        .blocked(center, &facing, (0.0, 1.0 - SELF_TOLERANCE))
        .into_iter();
    let mut unblocked = || blocked.next() == Some(false);
    lifted
        .iter()
        .map(|lifted| lifted.is_some() && unblocked())
        .collect()
}

#[cfg(test)]
mod tests;
