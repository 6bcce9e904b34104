//! What a synthetic scene is made of, and how its estimates are made worse.

/// What stands in a synthetic scene; each kind models one thing that reconstruction finds hard.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum SceneKind {
    /// A box and a sphere on the ground, seen from all around: nothing is hidden.
    #[default]
    Tabletop,
    /// A ball seen from one side: much of the surface is never seen.
    Object,
    /// A wall with bays along which the camera moves: planes, steps, grazing sides.
    Facade,
    /// Buildings in a plain with a far background: large depth ranges, partial views.
    Outdoor,
    /// Posts a few pixels wide.
    Thin,
}

/// What a synthetic scene is made of. Deterministic from `seed`.
#[derive(Debug, Clone, PartialEq)]
pub struct SyntheticOptions {
    /// What stands in it.
    pub kind: SceneKind,
    /// Seed of everything drawn.
    pub seed: u64,
    /// Number of cameras on the ring, 2 to 10000.
    pub views: u32,
    /// Image width in pixels.
    pub width: u32,
    /// Image height in pixels.
    pub height: u32,
}

impl Default for SyntheticOptions {
    fn default() -> Self {
        Self {
            kind: SceneKind::Tabletop,
            seed: 0,
            views: 12,
            width: 320,
            height: 240,
        }
    }
}

impl SyntheticOptions {
    /// The project's fixture scenes by name: small, each with its own difficulty.
    pub fn fixtures() -> [(&'static str, Self); 5] {
        let of = |kind, views| Self {
            kind,
            views,
            ..Self::default()
        };
        [
            ("object", of(SceneKind::Object, 10)),
            ("facade", of(SceneKind::Facade, 10)),
            ("outdoor", of(SceneKind::Outdoor, 10)),
            ("thin", of(SceneKind::Thin, 12)),
            ("sparse", of(SceneKind::Tabletop, 5)),
        ]
    }
}

/// How estimated depth maps differ from the truth.
#[derive(Debug, Clone, PartialEq)]
pub struct DepthNoise {
    /// Standard deviation of the Gaussian noise as a fraction of the depth.
    pub relative_sigma: f64,
    /// Fraction of pixels whose depth is drawn anew, uniformly over the view's range.
    pub outliers: f64,
    /// Fraction of pixels at depth edges whose depth lies between the two surfaces.
    pub flying: f64,
    /// Fraction of the area without a depth, in round holes; at most 0.95.
    pub holes: f64,
}

impl Default for DepthNoise {
    /// About as bad as a good learned method on textured scenes.
    fn default() -> Self {
        Self {
            relative_sigma: 0.001,
            outliers: 0.02,
            flying: 0.3,
            holes: 0.03,
        }
    }
}
