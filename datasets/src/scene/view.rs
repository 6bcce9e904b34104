use super::camera::{Camera, Pose};
use crate::error::{Error, Result};

/// The depths a view is meant to be searched over: 0 < min < max, finite, in world units.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DepthRange {
    min: f64,
    max: f64,
}

impl DepthRange {
    /// A range from its two ends.
    ///
    /// # Errors
    /// Ends that are not finite, a `min` that is not above 0, and a `max` that is not above it.
    pub fn new(min: f64, max: f64) -> Result<Self> {
        if min.is_finite() && max.is_finite() && 0.0 < min && min < max {
            return Ok(Self { min, max });
        }
        let problem = format!("expected 0 < min < max, found {min} and {max}");
        Err(Error::invalid("depth range", problem))
    }

    /// The smallest depth.
    pub fn min(&self) -> f64 {
        self.min
    }

    /// The largest depth.
    pub fn max(&self) -> f64 {
        self.max
    }

    /// The distance between `count` hypotheses as BlendedMVS counts it: (max − min) / count.
    pub fn interval(&self, count: u32) -> f64 {
        (self.max - self.min) / f64::from(count)
    }
}

/// An image, the camera that took it and where that camera stood.
#[derive(Debug, Clone, PartialEq)]
pub struct View {
    /// The view's number in its scene, as in its file names.
    pub id: u32,
    /// The image's file relative to the folder of images; empty when unknown.
    pub name: String,
    /// Image size and intrinsics.
    pub camera: Camera,
    /// Where the camera is.
    pub pose: Pose,
    /// The depths to search over, if known.
    pub depth_range: Option<DepthRange>,
}

/// A source view of some reference view and how well it is suited, larger is better.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SourceScore {
    /// The source view's id.
    pub id: u32,
    /// The view-selection score, ≥ 0.
    pub score: f64,
}

/// Views with distinct ids, ascending, and for each its source views, in the order in which they are given: best first, as they are written.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Scene {
    views: Vec<View>,
    sources: Vec<Vec<SourceScore>>,
}

impl Scene {
    /// A scene from views in any order, without source views. Ids must be distinct.
    ///
    /// # Errors
    /// An id twice.
    pub fn new(mut views: Vec<View>) -> Result<Self> {
        views.sort_by_key(|view| view.id);
        if let Some(pair) = views.windows(2).find(|pair| pair[0].id == pair[1].id) {
            let problem = format!("expected distinct view ids, found {} twice", pair[0].id);
            return Err(Error::invalid("scene", problem));
        }
        let sources = vec![Vec::new(); views.len()];
        Ok(Self { views, sources })
    }

    /// The same scene with source views, one list per view in [`Scene::views`] order. Every source
    /// is another view of the scene.
    ///
    /// # Errors
    /// A count of lists that is not that of the views, and a source that is the view itself or none of the scene.
    pub fn with_sources(mut self, sources: Vec<Vec<SourceScore>>) -> Result<Self> {
        if sources.len() != self.views.len() {
            let (expected, found) = (self.views.len(), sources.len());
            let problem = format!("expected {expected} lists of source views, found {found}");
            return Err(Error::invalid("scene", problem));
        }
        for (view, list) in self.views.iter().zip(&sources) {
            for source in list {
                if source.id == view.id || self.index_of(source.id).is_none() {
                    let problem = format!(
                        "expected the sources of view {} to be other views of the scene, found {}",
                        view.id, source.id
                    );
                    return Err(Error::invalid("scene", problem));
                }
            }
        }
        self.sources = sources;
        Ok(self)
    }

    /// All views, by ascending id.
    pub fn views(&self) -> &[View] {
        &self.views
    }

    /// Source views of the view at `index` of [`Scene::views`], in the order given: best first in what this crate writes, and as the file has them in others.
    pub fn sources_of(&self, index: usize) -> &[SourceScore] {
        &self.sources[index]
    }

    /// Where the view with this id stands in [`Scene::views`].
    pub fn index_of(&self, id: u32) -> Option<usize> {
        self.views.binary_search_by_key(&id, |view| view.id).ok()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec2;

    fn view(id: u32) -> View {
        let camera = Camera::new(4, 3, DVec2::splat(4.0), DVec2::new(2.0, 1.5)).unwrap();
        View {
            id,
            name: String::new(),
            camera,
            pose: Pose::IDENTITY,
            depth_range: None,
        }
    }

    #[test]
    fn views_are_sorted_and_distinct() {
        let scene = Scene::new(vec![view(7), view(2)]).unwrap();
        assert_eq!(
            scene.views().iter().map(|v| v.id).collect::<Vec<_>>(),
            [2, 7]
        );
        assert_eq!((scene.index_of(7), scene.index_of(3)), (Some(1), None));
        assert!(Scene::new(vec![view(2), view(2)]).is_err());
    }

    #[test]
    fn sources_are_other_views_of_the_scene() {
        let scene = Scene::new(vec![view(0), view(1)]).unwrap();
        let source = |id| vec![SourceScore { id, score: 1.0 }];
        assert!(
            scene
                .clone()
                .with_sources(vec![source(1), source(0)])
                .is_ok()
        );
        assert!(
            scene
                .clone()
                .with_sources(vec![source(0), source(0)])
                .is_err()
        );
        assert!(
            scene
                .clone()
                .with_sources(vec![source(5), source(0)])
                .is_err()
        );
        assert!(scene.with_sources(vec![source(1)]).is_err());
    }

    #[test]
    fn ranges_are_positive_and_ordered() {
        assert!((DepthRange::new(1.0, 3.0).unwrap().interval(128) - 2.0 / 128.0).abs() < 1e-15);
        for (min, max) in [(0.0, 1.0), (-1.0, 1.0), (2.0, 2.0), (1.0, f64::INFINITY)] {
            assert!(DepthRange::new(min, max).is_err());
        }
    }
}
