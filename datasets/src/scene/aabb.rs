use glam::DVec3;

/// An axis-aligned box in world units. [`Aabb::EMPTY`] is the identity of [`Aabb::union`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Aabb {
    /// The smallest coordinate on each axis; above `max` when the box is empty.
    pub min: DVec3,
    /// The largest coordinate on each axis.
    pub max: DVec3,
}

impl Aabb {
    /// The box that holds nothing.
    pub const EMPTY: Self = Self {
        min: DVec3::splat(f64::INFINITY),
        max: DVec3::splat(f64::NEG_INFINITY),
    };

    /// The smallest box around `points`; [`Aabb::EMPTY`] when there are none.
    pub fn around(points: impl IntoIterator<Item = DVec3>) -> Self {
        points.into_iter().fold(Self::EMPTY, Self::including)
    }

    /// The smallest box around this one and `point`.
    #[must_use]
    pub fn including(self, point: DVec3) -> Self {
        Self {
            min: self.min.min(point),
            max: self.max.max(point),
        }
    }

    /// The smallest box around both.
    #[must_use]
    pub fn union(self, other: Self) -> Self {
        Self {
            min: self.min.min(other.min),
            max: self.max.max(other.max),
        }
    }

    /// Whether the box holds nothing.
    pub fn is_empty(&self) -> bool {
        !self.min.cmple(self.max).all()
    }

    /// Edge lengths; zero when empty.
    pub fn size(&self) -> DVec3 {
        if self.is_empty() {
            DVec3::ZERO
        } else {
            self.max - self.min
        }
    }

    /// The centre; the origin when empty.
    pub fn center(&self) -> DVec3 {
        if self.is_empty() {
            DVec3::ZERO
        } else {
            self.min + 0.5 * (self.max - self.min)
        }
    }

    /// Whether `point` lies inside or on the border.
    pub fn contains(&self, point: DVec3) -> bool {
        self.min.cmple(point).all() && point.cmple(self.max).all()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn empty_is_the_identity_of_union() {
        let some = Aabb::around([DVec3::new(1.0, -2.0, 3.0), DVec3::new(-1.0, 5.0, 3.0)]);
        assert_eq!(Aabb::EMPTY.union(some), some);
        assert_eq!(some.union(Aabb::EMPTY), some);
        assert!(Aabb::EMPTY.is_empty() && !some.is_empty());
        assert_eq!(Aabb::EMPTY.size(), DVec3::ZERO);
        assert_eq!(some.size(), DVec3::new(2.0, 7.0, 0.0));
        assert_eq!(some.center(), DVec3::new(0.0, 1.5, 3.0));
    }

    #[test]
    fn border_counts_as_inside() {
        let unit = Aabb {
            min: DVec3::ZERO,
            max: DVec3::ONE,
        };
        assert!(unit.contains(DVec3::ZERO) && unit.contains(DVec3::ONE));
        assert!(!unit.contains(DVec3::new(0.5, 0.5, 1.0 + 1e-15)));
        assert!(!Aabb::EMPTY.contains(DVec3::ZERO));
    }
}
