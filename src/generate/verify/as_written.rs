//! Whether the files of views are those that `scene.json` says were made.

use super::Finding;
use crate::generate::likeness;
use crate::parallel;
use crate::provenance;
use mvs_datasets::layout::blended::BlendedFolder;
use mvs_datasets::layout::blended::record::{self, SceneFile};

/// One fault for all files that are gone, one for all with other bytes, and one for each view whose photograph
/// was found not to match its rendering; an error where `scene.json` cannot
/// be read.
pub(super) fn check(folder: &BlendedFolder) -> Result<Vec<Finding>, mvs_datasets::Error> {
    let Some(record) = record::read(&folder.record())? else {
        return Ok(Vec::new());
    };
    let files = record.views.iter().flat_map(|view| &view.files);
    let files: Vec<(&String, &String)> = files.collect();
    let states = parallel::map(files.len(), |index| {
        let (name, hash) = files[index];
        provenance::hash_path(&folder.path().join(name)).map(|found| found == *hash)
    });
    let of = |is: fn(&crate::error::Result<bool>) -> bool| {
        let files = files.iter().zip(&states);
        let files = files.filter(move |(_, state)| is(state));
        files.map(|((name, _), _)| name.as_str())
    };
    let gone = found(
        of(|state| state.is_err()),
        files.len(),
        "found none: bring them back, or make the scene again",
    );
    let other = found(
        of(|state| matches!(state, Ok(false))),
        files.len(),
        "found other bytes: they were damaged or changed; make the scene again, or take scene.json away \
         where that was meant",
    );
    Ok(gone
        .into_iter()
        .chain(other)
        .chain(unlike(&record))
        .collect())
}

/// A fault for each view whose photograph did not match when the scene was made, advice where very coarse colours of the
/// mesh could be why: images, which are made from both, cannot show it afterwards.
fn unlike(record: &SceneFile) -> Vec<Finding> {
    let views = record.views.iter();
    let unlike = views.filter_map(|view| {
        let found = view
            .likeness
            .filter(|_| likeness::is_unlike(view.likeness))?;
        let message = format!(
            "expected a photograph that shows what the rendering shows, found another: {}",
            likeness::explained(found)
        );
        let finding = match likeness::is_surely_unlike(found) {
            true => Finding::fault,
            false => Finding::advice,
        };
        Some(finding(
            likeness::CODE,
            format!("view {}", view.id),
            message,
        ))
    });
    unlike.collect()
}

/// A fault at the first of these files, if there is any.
fn found<'a>(mut names: impl Iterator<Item = &'a str>, all: usize, found: &str) -> Option<Finding> {
    let first = names.next()?;
    let message = format!(
        "expected the files that scene.json says were made, of {} of {all} (this is the first) {found}",
        1 + names.count()
    );
    Some(Finding::fault("not-as-written", first, message))
}
