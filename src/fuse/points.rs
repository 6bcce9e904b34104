//! Points on their way out, by column.

use super::rows::Entries;
use crate::error::Result;
use glam::{DVec3, Vec3};
use mvs_datasets::scene::PointCloud;

/// Which columns points have. Positions and view counts are always there.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Columns(u8);

/// How many kinds of rows of bytes there are.
pub(super) const ROW_KINDS: usize = 64;

impl Columns {
    /// Unit normals in the world frame; zero where unknown.
    pub const NORMALS: Self = Self(1);
    /// Colours.
    pub const COLORS: Self = Self(2);
    /// Confidences.
    pub const CONFIDENCES: Self = Self(4);
    /// Violations and scales: [`Points`] always have them, rows of bytes may not.
    pub const EXTRAS: Self = Self(8);
    /// Positions as f64 in rows of bytes, which have them as f32 otherwise: [`Points`] always have f64.
    pub const DOUBLES: Self = Self(16);
    /// Numbers of views as f32 in rows of bytes, which have them as u8 otherwise: for scenes of more than 255 views.
    pub const MANY: Self = Self(32);
    /// Which views see each point; rows of bytes never have that.
    pub const VISIBLE: Self = Self(64);

    /// As an index: of what rows of bytes may have.
    pub(super) const fn row_bits(self) -> u8 {
        self.0 & (ROW_KINDS as u8 - 1)
    }

    pub(super) const fn of_row_bits(bits: u8) -> Self {
        Self(bits & (ROW_KINDS as u8 - 1))
    }

    /// Both together.
    #[must_use]
    pub fn and(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }

    /// These if `wanted`, else none.
    #[must_use]
    pub fn when(self, wanted: bool) -> Self {
        if wanted { self } else { Self(0) }
    }

    /// Whether all of `other` are among these.
    pub const fn has(self, other: Self) -> bool {
        self.0 & other.0 == other.0
    }
}

/// Some points. Columns that [`Columns`] leaves out are empty, the others have one entry per point.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Points {
    /// Positions in world units.
    pub positions: Vec<DVec3>,
    /// Unit normals in the world frame, facing the reference view; zero where unknown.
    pub normals: Vec<Vec3>,
    /// 8-bit sRGB.
    pub colors: Vec<[u8; 3]>,
    /// Distinct views that agree, the reference counted.
    pub view_counts: Vec<u32>,
    /// The reference pixel's confidence; 0 where that is too little, and the depth was filled in from others.
    pub confidences: Vec<f32>,
    /// The reference's pixels, row-major; empty where points are of no single pixel.
    pub pixels: Vec<u32>,
    /// Views that see through the point.
    pub violations: Vec<u32>,
    /// Depth over focal length: what a reference pixel spans at the point, in world units.
    pub scales: Vec<f32>,
    /// The numbers of the views that agree, the reference first, point after point.
    pub visible_in: Vec<u32>,
}

impl Points {
    /// How many points.
    pub fn len(&self) -> usize {
        self.positions.len()
    }

    /// Whether there are no points.
    pub fn is_empty(&self) -> bool {
        self.positions.is_empty()
    }

    /// Adds entry `i` of some points, but for the views that see it.
    pub(super) fn add(&mut self, columns: Columns, points: &impl Entries, i: usize) {
        self.positions.push(points.position(i).into());
        self.view_counts.push(points.view_count(i));
        let (violations, scale) = points.extras(i);
        self.violations.push(violations);
        self.scales.push(scale);
        self.pixels.push(points.pixel(i));
        if columns.has(Columns::NORMALS) {
            self.normals.push(points.normal(i).into());
        }
        if columns.has(Columns::COLORS) {
            self.colors.push(points.color(i));
        }
        if columns.has(Columns::CONFIDENCES) {
            self.confidences.push(points.confidence(i));
        }
    }

    /// Moves `other`'s points to the end of these; its memory can be used again.
    pub fn append(&mut self, other: &mut Self) {
        self.positions.append(&mut other.positions);
        self.normals.append(&mut other.normals);
        self.colors.append(&mut other.colors);
        self.view_counts.append(&mut other.view_counts);
        self.confidences.append(&mut other.confidences);
        self.violations.append(&mut other.violations);
        self.scales.append(&mut other.scales);
        self.pixels.append(&mut other.pixels);
        self.visible_in.append(&mut other.visible_in);
    }

    /// Forgets all points and keeps their memory.
    pub fn clear(&mut self) {
        self.positions.clear();
        self.normals.clear();
        self.colors.clear();
        self.view_counts.clear();
        self.confidences.clear();
        self.violations.clear();
        self.scales.clear();
        self.pixels.clear();
        self.visible_in.clear();
    }

    /// As a cloud with the columns that there are.
    ///
    /// # Errors
    /// Columns that have not one entry per point.
    pub fn into_cloud(self, columns: Columns) -> Result<PointCloud> {
        let mut cloud = PointCloud::new(self.positions).with_view_counts(self.view_counts)?;
        if columns.has(Columns::NORMALS) {
            cloud = cloud.with_normals(self.normals)?;
        }
        if columns.has(Columns::COLORS) {
            cloud = cloud.with_colors(self.colors)?;
        }
        if columns.has(Columns::CONFIDENCES) {
            cloud = cloud.with_confidences(self.confidences)?;
        }
        Ok(cloud)
    }
}

/// Takes points as they are finished: by view, row-major within a view.
pub trait PointSink {
    /// Takes some points of a view.
    ///
    /// # Errors
    /// What stands in the way of writing them.
    fn take(&mut self, points: &Points) -> Result<()>;
    /// The columns of the rows that it takes instead, if it does; those that the points do not have must not be
    /// among them.
    fn wants_rows(&self) -> Option<Columns> {
        None
    }
    /// Takes some points of a view as rows of bytes, where it wants them; else points. Little-endian and without
    /// gaps: the position as three f32 or f64, the normal as three f32, the colour, the number of views as u8 or f32,
    /// the confidence as f32, the violations as the number of views and the scale as f32, of which columns leave out
    /// some.
    ///
    /// # Errors
    /// What stands in the way of writing them.
    fn take_rows(&mut self, _rows: &[u8]) -> Result<()> {
        Ok(())
    }
    /// Hears that a view has no more points; called for every view.
    ///
    /// # Errors
    /// What stands in the way of writing what was held back for it.
    fn view_done(&mut self) -> Result<()> {
        Ok(())
    }
    /// Whether [`Points::visible_in`] is asked for; else it is empty.
    fn wants_visible(&self) -> bool {
        true
    }
}

impl PointSink for Points {
    fn take(&mut self, points: &Points) -> Result<()> {
        self.append(&mut points.clone());
        Ok(())
    }
}
