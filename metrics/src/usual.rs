//! Which points of a cloud lie where the others do.

use glam::DVec3;

/// The part of the points that may lie beyond either end of an axis without moving the box.
const TAIL: f64 = 0.01;

/// A box, parallel to the axes, that a few points far from all others do not stretch.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Usual {
    min: DVec3,
    max: DVec3,
}

impl Usual {
    /// From 1 % to 99 % of the finite points along each axis, widened at each end by the longest side of that.
    /// All of space where the points give no such side.
    pub fn of(points: impl Iterator<Item = DVec3>) -> Self {
        let mut columns = [Vec::new(), Vec::new(), Vec::new()];
        for point in points.filter(|point| point.is_finite()) {
            for (column, along) in columns.iter_mut().zip(point.to_array()) {
                column.push(along);
            }
        }
        let [x, y, z] = columns.map(|mut column| middle(&mut column));
        let (low, high) = (DVec3::new(x.0, y.0, z.0), DVec3::new(x.1, y.1, z.1));
        let widening = (high - low).max_element();
        let widening = if widening > 0.0 {
            widening
        } else {
            f64::INFINITY
        };
        Self {
            min: low - widening,
            max: high + widening,
        }
    }

    /// The box with so much more room on each side.
    pub fn grown(self, by: f64) -> Self {
        Self {
            min: self.min - by,
            max: self.max + by,
        }
    }

    /// Whether the point lies in the box.
    pub fn holds(&self, point: DVec3) -> bool {
        self.min.cmple(point).all() && point.cmple(self.max).all()
    }
}

/// The values that leave out a tail at either end; 0 of none.
fn middle(values: &mut [f64]) -> (f64, f64) {
    let Some(last) = values.len().checked_sub(1) else {
        return (0.0, 0.0);
    };
    let tail = (last as f64 * TAIL).floor() as usize;
    let low = *values.select_nth_unstable_by(tail, f64::total_cmp).1;
    let high = *values.select_nth_unstable_by(last - tail, f64::total_cmp).1;
    (low, high)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn line(count: u32) -> impl Iterator<Item = DVec3> {
        (0..count).map(|i| DVec3::X * f64::from(i))
    }

    #[test]
    fn the_box_is_three_times_the_middle_and_a_few_far_points_do_not_stretch_it() {
        let expected = Usual {
            min: DVec3::new(10.0 - 980.0, -980.0, -980.0),
            max: DVec3::new(990.0 + 980.0, 980.0, 980.0),
        };
        assert_eq!(Usual::of(line(1001)), expected);
        let far = [DVec3::splat(1e300), DVec3::NAN, DVec3::NEG_INFINITY];
        let stretched = Usual::of(line(1000).chain(far));
        assert_eq!(stretched, expected);
        assert!(line(1000).all(|point| stretched.holds(point)));
        assert!(far.into_iter().all(|point| !stretched.holds(point)));
        let beyond = DVec3::X * 1975.0;
        assert!(!stretched.holds(beyond) && stretched.grown(10.0).holds(beyond));
    }

    #[test]
    fn points_in_one_place_and_none_leave_nothing_out() {
        for usual in [
            Usual::of(line(0)),
            Usual::of(line(1)),
            Usual::of((0..500).map(|i| if i == 0 { DVec3::X } else { DVec3::ONE })),
        ] {
            assert!(usual.holds(DVec3::splat(1e9)) && usual.holds(DVec3::ZERO));
        }
    }
}
