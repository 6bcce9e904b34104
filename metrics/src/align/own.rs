//! How far moved centres are from their own targets, eight at a time.

use super::trajectory::Rule;
use crate::distance::squared_distance;
use glam::{DMat4, DVec3};

/// Centres looked at together.
pub(super) const EIGHT: usize = 8;

/// Corresponding centres as columns, filled up to whole eights by the last pair.
pub(super) struct Own {
    source: [Vec<f64>; 3],
    target: [Vec<f64>; 3],
    /// Per centre a squared distance: when it is nearer than that to its own target, no target by which
    /// it may be judged is nearer.
    pub(super) near: Vec<f64>,
}

impl Own {
    pub(super) fn new(source: &[DVec3], target: &[DVec3], rule: Rule) -> Self {
        let count = source.len().next_multiple_of(EIGHT);
        let columns = |side: &[DVec3]| {
            let last = side.len() - 1;
            std::array::from_fn(|axis| (0..count).map(|i| side[i.min(last)][axis]).collect())
        };
        let near = |(i, &own): (usize, &DVec3)| {
            let others = target.iter().enumerate().filter(|&(j, _)| j != i);
            let squares = others.map(|(_, &other)| squared_distance(own, other));
            // Half the way to the nearest other one, less all rounding.
            let near = 0.2499 * squares.fold(f64::INFINITY, f64::min);
            if near.is_finite() { near } else { 0.0 }
        };
        let near = match rule {
            Rule::Official => target.iter().enumerate().map(near).collect(),
            Rule::Strict => vec![f64::INFINITY; target.len()],
        };
        Self {
            source: columns(source),
            target: columns(target),
            near,
        }
    }

    /// The squared distances of eight moved centres to their own targets: those of [`transform`] and
    /// [`squared_distance`].
    #[inline]
    pub(super) fn squares(&self, first: usize, motion: DMat4) -> [f64; EIGHT] {
        let column = |columns: &[Vec<f64>; 3], axis: usize| {
            let mut eight = [0.0; EIGHT];
            eight.copy_from_slice(&columns[axis][first..first + EIGHT]);
            eight
        };
        let (x, y, z) = (
            column(&self.source, 0),
            column(&self.source, 1),
            column(&self.source, 2),
        );
        let (a, b, c, d) = (motion.x_axis, motion.y_axis, motion.z_axis, motion.w_axis);
        let mut squares = [0.0; EIGHT];
        for axis in 0..3 {
            let target = column(&self.target, axis);
            for k in 0..EIGHT {
                let moved = a[axis] * x[k] + b[axis] * y[k] + c[axis] * z[k] + d[axis];
                squares[k] += (moved - target[k]) * (moved - target[k]);
            }
        }
        squares
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::align::tests::scattered;
    use crate::align::transform;

    #[test]
    fn squares_are_those_of_single_centres_and_near_ones_have_no_nearer_target() {
        let (source, target) = (scattered(90, 21), scattered(91, 21));
        let own = Own::new(&source, &target, Rule::Official);
        let turn = DMat4::from_scale_rotation_translation(
            DVec3::splat(0.3),
            glam::DQuat::from_rotation_y(0.4),
            DVec3::new(0.1, -0.2, 0.3),
        );
        let mut near = 0;
        for (nth, motion) in [DMat4::IDENTITY, turn].into_iter().enumerate() {
            for first in (0..21).step_by(EIGHT) {
                let squares = own.squares(first, motion);
                for (i, square) in (first..21).zip(squares) {
                    let moved = transform(motion, source[i]);
                    let exact = squared_distance(moved, target[i]);
                    assert_eq!(square, exact, "{nth} {i}");
                }
            }
        }
        // On its own target, and from there towards each other one.
        for (i, &own_target) in target.iter().enumerate() {
            for &other in &target {
                for step in [0.0, 0.3, 0.49, 0.51, 0.7] {
                    let place = own_target + step * (other - own_target);
                    let square = squared_distance(place, own_target);
                    if square < own.near[i] {
                        near += 1;
                        let nearest = target.iter().map(|&t| squared_distance(place, t));
                        assert_eq!(nearest.fold(f64::INFINITY, f64::min), square);
                    }
                }
            }
        }
        assert!(near > 21 * 6, "{near}");
    }
}
