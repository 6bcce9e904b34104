//! Which views belong into a scene, and their sources.

use super::scene::Source;
use super::shard::Part;
use super::{Covisibility, Extra, Fit, GenerateOptions, pairs};
use crate::error::{Error, Result};
use crate::parallel;
use crate::progress::Progress;
use crate::render::Renderer;
use mvs_datasets::layout::blended::record::LeftOut;
use mvs_datasets::scene::{SourceScore, View};
use std::collections::BTreeSet;

/// The views that belong into the scene, as given and ascending by id, and their source views.
#[derive(Debug)]
pub(super) struct Plan {
    pub(super) views: Vec<View>,
    /// Where each of the views stands among all that were given.
    pub(super) places: Vec<usize>,
    pub(super) sources: Vec<Vec<SourceScore>>,
    pub(super) left_out: Vec<LeftOut>,
    /// Square, if asked for.
    pub(super) covisibility: Vec<f32>,
}

/// Chooses the views and their sources. A shard that writes nothing of other views takes every view
/// that sees surface: which of them belong into the scene is the merge's to find.
pub(super) fn plan_scene(
    source: &Source<'_>,
    (sizes, part): (&[Option<(u32, u32)>], Part),
    (renderer, options): (&Renderer<'_>, &GenerateOptions),
    progress: &dyn Progress,
) -> Result<Plan> {
    options.pairs.check()?;
    let mut given: Vec<usize> = (0..source.views.len()).collect();
    given.sort_by_key(|&place| source.views[place].id);
    let views: Vec<View> = given.iter().map(|&i| source.views[i].clone()).collect();
    let sets = sizes.iter().map(|&size| fitted_to(&views, size));
    let sets = sets.collect::<Result<Vec<Vec<View>>>>()?;
    let surface = (renderer, source.mesh);
    let look = (&options.pairs, options.render.back_faces);
    let sees = |&place: &usize| {
        let mut in_sets = sets.iter().map(|fitted| &fitted[place]);
        in_sets.all(|view| pairs::sees_surface(surface, view, look))
    };
    let occlusion = options.extras.contains(&Extra::Occlusion);
    if matches!(part, Part::Shard { .. }) && !occlusion {
        let mine = |place: &usize| part.holds(*place) && sees(place);
        let places: Vec<usize> = (0..views.len()).filter(mine).collect();
        let nobody = vec![Vec::new(); views.len()];
        return Ok(Plan::new((&views, places), nobody, &[]));
    }
    let wanted = source.sources.is_none() || options.extras.contains(&Extra::Covisibility);
    let covisibility = match wanted {
        true => Some(Covisibility::measure(surface, &sets[0], look, progress)?),
        false => None,
    };
    let seeing = parallel::map_pieces(views.len(), |place| sees(&place));
    let chosen = match (source.sources, &covisibility) {
        (None, Some(covisibility)) => covisibility.sources(&sets[0], options.pairs.sources),
        (chosen, _) => (given.iter())
            .map(|&i| chosen.map_or_else(Vec::new, |all| all[i].clone()))
            .collect(),
    };
    let blind = (0..views.len()).filter(|&place| !seeing[place]);
    let blind: BTreeSet<u32> = blind.map(|place| views[place].id).collect();
    let sources = pairs::without(&views, chosen, blind);
    let has_sources = |&place: &usize| !sources[place].is_empty();
    let places: Vec<usize> = (0..views.len()).filter(has_sources).collect();
    if places.is_empty() {
        let behind = pairs::count_behind(surface, &sets[0], look);
        let share = covisibility.as_ref().is_some_and(Covisibility::any_share);
        if source.sources.is_some() && seeing.iter().filter(|&&sees| sees).count() > 1 {
            let count = views.len();
            let problem = format!(
                "expected views that are each other's sources, found none among {count}: {POINTS}"
            );
            return Err(Error::invalid("views", problem));
        }
        return Err(no_pair(views.len(), behind, share));
    }
    let left_out = (0..views.len()).filter(|place| !has_sources(place));
    let left_out = left_out.map(|place| LeftOut {
        id: views[place].id,
        reason: match (seeing[place], source.sources) {
            (true, Some(_)) => POINTS.to_owned(),
            (sees, _) => reason(sees, covisibility.as_ref(), place).to_owned(),
        },
    });
    let left_out = left_out.collect();
    let shared = covisibility.as_ref().map_or(&[][..], Covisibility::shared);
    Ok(Plan {
        left_out,
        ..Plan::new((&views, places), sources, shared)
    })
}

/// Why a view that sees the surface is in no pair that was given.
const POINTS: &str = "the points of the COLMAP model give it no source view that is in the set: --pairs exact \
                      takes the mesh instead";

/// No two of `count` views are each other's sources: though some `share` surface, or `behind` of them see only the
/// backs of triangles.
fn no_pair(count: usize, behind: usize, share: bool) -> Error {
    if share {
        return Error::invalid("views", too_far_apart(count));
    }
    let why = match behind {
        0 => "are mesh and cameras in the same frame, and poses world-to-camera?".to_owned(),
        _ => format!(
            "{behind} of them see only the backs of triangles: if the faces are wound the other way, \
             --back-faces valid takes both sides"
        ),
    };
    let problem = format!(
        "expected at least two views that see the same surface, found none among {count}; {why}"
    );
    Error::invalid("views", problem)
}

/// The views, fitted to images of `size`.
pub(super) fn fitted_to(views: &[View], size: Option<(u32, u32)>) -> Result<Vec<View>> {
    let fit = |view: &View| Ok(Fit::undistorting(&view.camera, size)?.view(view));
    views.iter().map(fit).collect()
}

/// What to say where `count` views see the same surface, and no two of them from directions near enough.
pub(crate) fn too_far_apart(count: usize) -> String {
    format!(
        "expected views that see the same surface from directions near each other, found none among {count}: \
         some see it, but under angles so far from the best that all scores round to 0; views between them help"
    )
}

/// Why the view at `place` is left out.
fn reason(sees: bool, covisibility: Option<&Covisibility>, place: usize) -> &'static str {
    let shares = covisibility.is_some_and(|all| all.shares(place));
    match (sees, shares) {
        (false, _) => "at the size of one of the sets it sees no surface",
        (true, false) => "no other view sees the surface that it sees",
        (true, true) => {
            "other views see the surface that it sees, but none under an angle that counts: all \
             scores round to 0"
        }
    }
}

impl Plan {
    /// The plan for the views at some places of all, with their sources and, of the square table of
    /// all, their part.
    fn new(
        (all, places): (&[View], Vec<usize>),
        mut sources: Vec<Vec<SourceScore>>,
        shared: &[f32],
    ) -> Self {
        let cells = |&row: &usize| places.iter().map(move |&column| row * all.len() + column);
        let cells = places.iter().flat_map(cells);
        Self {
            left_out: Vec::new(),
            covisibility: cells.filter_map(|cell| shared.get(cell).copied()).collect(),
            views: places.iter().map(|&place| all[place].clone()).collect(),
            sources: (places.iter())
                .map(|&place| std::mem::take(&mut sources[place]))
                .collect(),
            places,
        }
    }
}
