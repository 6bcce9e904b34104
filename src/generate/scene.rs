//! A scene as a whole: which views belong into it, their sources, and what stands beside them.

use super::choice::{Plan, fitted_to, plan_scene};
use super::likeness::warning_of_unlike;
use super::shard::Part;
use super::view::ViewWork;
use super::{Extra, GenerateOptions, Photographs, leftovers, plan};
use crate::blend::Blender;
use crate::error::{Error, Result};
use crate::parallel;
use crate::progress::Progress;
use crate::render::Renderer;
use crate::warning::{Warnings, of_back_faces};
use mvs_datasets::format::npy;
use mvs_datasets::layout::blended::BlendedFolder;
use mvs_datasets::layout::blended::record::{self, SceneFile, ViewRecord};
use mvs_datasets::layout::mvsnet::{self, PixelCentre};
use mvs_datasets::layout::{exports, files};
use mvs_datasets::scene::{Mesh, Scene, SourceScore, View};
use std::collections::{BTreeMap, BTreeSet};

/// What a scene is generated from.
#[derive(Clone, Copy)]
pub struct Source<'a> {
    /// The scene's name.
    pub name: &'a str,
    /// The name of its folder, as [`super::scene_id`] makes it from the name.
    pub id: &'a str,
    /// The textured surface.
    pub mesh: &'a Mesh,
    /// The cameras, as they took the photographs.
    pub views: &'a [View],
    /// The photographs.
    pub photographs: &'a dyn Photographs,
    /// Sentences on the mesh for whoever uses the scene, e.g. missing textures.
    pub notes: &'a [String],
    /// Source views of each of `views`, best first, where they are chosen already, as by
    /// [`super::sparse_sources`]; `None` to choose them by exact visibility.
    pub sources: Option<&'a [Vec<SourceScore>]>,
}

/// Where a set of the scene is written, and the size of its images.
#[derive(Debug, Clone)]
pub struct Target {
    /// The scene's folder.
    pub folder: BlendedFolder,
    /// Width and height of its images, as [`GenerateOptions::size`].
    pub size: Option<(u32, u32)>,
}

/// What became of a set.
#[derive(Debug, Clone, PartialEq)]
pub struct Generated {
    /// Views that are finished now.
    pub views: usize,
    /// What `scene.json` says; `None` where only a shard was made.
    pub scene: Option<SceneFile>,
}

/// One set of the scene: its views' images all have the size that the options say.
struct SetWork<'a> {
    source: &'a Source<'a>,
    plan: &'a Plan,
    folder: &'a BlendedFolder,
    options: GenerateOptions,
    /// The views of the plan, fitted.
    fitted: Vec<View>,
    part: Part,
}

/// Generates the scene in `folder`. Views that are there already, made from the same inputs with
/// the same options, are kept. `scene.json` is written last: a folder without it is not finished.
///
/// # Errors
/// As [`generate_sets`].
pub fn generate(
    source: &Source<'_>,
    folder: &BlendedFolder,
    options: &GenerateOptions,
    progress: &dyn Progress,
    warnings: &Warnings,
) -> Result<SceneFile> {
    let target = Target {
        folder: folder.clone(),
        size: options.size,
    };
    let work = (&[target][..], Part::All);
    let made = generate_sets(source, work, options, &mut |_| {}, progress, warnings)?;
    let scene = made.into_iter().find_map(|made| made.scene);
    scene.ok_or_else(|| Error::invalid("scene", "expected a whole scene, found a part of one"))
}

/// Generates sets of the scene that differ in image size, or a part of them. Source views are chosen
/// at the first target's size and hold for all, and a view must see surface in each; depth is rendered
/// at each size. `options.size` is not looked at. `begin` is told the place of each target just before
/// what lies there is changed.
///
/// # Errors
/// Options out of range, no target, a mesh that cannot be rendered, views of which no two are each other's sources, a
/// photograph that cannot be read or has another shape than its camera, no surface at a view's pixel centres, views
/// that no shard has finished where shards are merged, whatever writing brings, and interruption.
pub fn generate_sets(
    source: &Source<'_>,
    (targets, part): (&[Target], Part),
    options: &GenerateOptions,
    begin: &mut dyn FnMut(usize),
    progress: &dyn Progress,
    warnings: &Warnings,
) -> Result<Vec<Generated>> {
    options.check()?;
    let sizes: Vec<_> = targets.iter().map(|target| target.size).collect();
    if sizes.is_empty() {
        return Err(Error::invalid("image sizes", "expected one, found none"));
    }
    let renderer = Renderer::new(source.mesh)?;
    let plan = plan_scene(source, (&sizes, part), (&renderer, options), progress)?;
    for left_out in &plan.left_out {
        let message = format!("view {} is left out: {}", left_out.id, left_out.reason);
        warnings.add("view-left-out", message);
    }
    let mesh = plan::mesh_digest(source.mesh);
    let set = |(index, target): (usize, &Target)| {
        let options = GenerateOptions {
            size: target.size,
            ..options.clone()
        };
        let digest = plan::scene_digest(&mesh, &options)?;
        let set = SetWork {
            source,
            plan: &plan,
            folder: &target.folder,
            options,
            fitted: fitted_to(&plan.views, target.size)?,
            part,
        };
        let blenders = set.blenders()?;
        let work = set.work(&renderer, &digest, &blenders);
        set.make(&work, &mut || begin(index), progress, warnings)
    };
    targets.iter().enumerate().map(set).collect()
}

/// What becomes of a view, given and fitted, and of those that watch it.
type Each<'e> = dyn Fn((&View, &View), &[View]) -> Result<Option<ViewRecord>> + Sync + 'e;

impl SetWork<'_> {
    fn work<'w>(
        &'w self,
        renderer: &'w Renderer<'w>,
        scene_digest: &'w str,
        blenders: &'w BTreeMap<(u32, u32), Blender>,
    ) -> ViewWork<'w> {
        ViewWork {
            source: self.source,
            renderer,
            folder: self.folder,
            options: &self.options,
            scene_digest,
            blenders,
        }
    }

    /// Makes the part's views, and the scene's own files unless that is a shard.
    fn make(
        &self,
        work: &ViewWork<'_>,
        begin: &mut dyn FnMut(),
        progress: &dyn Progress,
        warnings: &Warnings,
    ) -> Result<Generated> {
        let mine: Vec<usize> = (0..self.fitted.len())
            .filter(|&index| self.part.holds(self.plan.places[index]))
            .collect();
        let mut change = || {
            // From here on the set is another one, or not whole.
            begin();
            leftovers::remove_if_there(&self.folder.record())
        };
        let each = |view: &Each<'_>| {
            progress.begin("generating views", mine.len() as u64);
            parallel::try_map_pieces(mine.len(), |at| {
                progress.check()?;
                let index = mine[at];
                let views = (&self.plan.views[index], &self.fitted[index]);
                let record = view(views, &self.watchers(index))?;
                progress.advance(1);
                Ok(record)
            })
        };
        let find = || each(&|views, watchers| work.find(views, watchers));
        let mut found = match self.part {
            Part::Merge => Some(find()?),
            // A whole scene stays one where the shard has nothing to do.
            Part::Shard { .. } if self.folder.record().is_file() => Some(find()?),
            Part::All | Part::Shard { .. } => None,
        };
        if self.part != Part::Merge {
            found = found.filter(|records| records.iter().all(Option::is_some));
        }
        let records = match found {
            Some(found) => found,
            None => {
                change()?;
                each(&|views, watchers| Ok(Some(work.finish(views, watchers)?)))?
            }
        };
        let unfinished = (mine.iter().zip(&records)).filter(|(_, record)| record.is_none());
        let unfinished: Vec<usize> = unfinished.map(|(&index, _)| index).collect();
        self.refuse(&unfinished)?;
        if self.part == Part::Merge {
            change()?;
        }
        let records: Vec<ViewRecord> = records.into_iter().flatten().collect();
        for (code, message) in of_records(&records) {
            warnings.add(&code, message);
        }
        Ok(Generated {
            views: records.len(),
            scene: match self.part {
                Part::Shard { .. } => None,
                Part::All | Part::Merge => Some(self.write_scene(records)?),
            },
        })
    }

    /// A blender for each image size, to be used for all views; none where no view is made.
    fn blenders(&self) -> Result<BTreeMap<(u32, u32), Blender>> {
        if self.part == Part::Merge {
            return Ok(BTreeMap::new());
        }
        let sizes = self.fitted.iter();
        let sizes = sizes.map(|view| (view.camera.width(), view.camera.height()));
        let sizes: BTreeSet<(u32, u32)> = sizes.collect();
        let made = sizes.into_iter().map(|size| {
            let blender = Blender::new(size, &self.options.blend)?;
            Ok((size, blender))
        });
        made.collect()
    }

    /// The views whose sight of the view at `index` is written with it: its sources, if occlusion
    /// is asked for.
    fn watchers(&self, index: usize) -> Vec<View> {
        if !self.options.extras.contains(&Extra::Occlusion) {
            return Vec::new();
        }
        let view_of = |source: &SourceScore| {
            let found = self.fitted.iter().find(|view| view.id == source.id)?;
            Some(found.clone())
        };
        let sources = self.plan.sources[index].iter();
        sources.filter_map(view_of).collect()
    }

    /// An error that names views which no shard has finished, if there are any.
    fn refuse(&self, unfinished: &[usize]) -> Result<()> {
        let Some(&first) = unfinished.first() else {
            return Ok(());
        };
        let problem = format!(
            "expected all views finished, by the same options and inputs, found {} of {} that are \
             not, the first of which is view {}: run the shard that makes it, then merge",
            unfinished.len(),
            self.fitted.len(),
            self.fitted[first].id
        );
        Err(Error::invalid(
            self.folder.path().display().to_string(),
            problem,
        ))
    }

    /// What the user should know of the scene, whoever made its views.
    fn warnings_of(&self, records: &[ViewRecord]) -> Vec<(String, String)> {
        let left_out = self.plan.left_out.iter().map(|view| {
            let message = format!("view {} is left out: {}", view.id, view.reason);
            ("view-left-out".to_owned(), message)
        });
        let notes = self.source.notes.iter();
        let notes = notes.map(|note| ("mesh".to_owned(), note.clone()));
        let mut all: Vec<_> = notes.chain(left_out).chain(of_records(records)).collect();
        all.sort();
        all.dedup();
        all
    }

    /// Writes what belongs to the scene as a whole.
    fn write_scene(&self, records: Vec<ViewRecord>) -> Result<SceneFile> {
        let (folder, options, plan) = (self.folder, &self.options, self.plan);
        let count = self.fitted.len();
        let scene = Scene::new(self.fitted.clone())?.with_sources(plan.sources.clone())?;
        mvsnet::write_pairs(&folder.pairs(), &scene)?;
        if options.extras.contains(&Extra::Covisibility) {
            files::write_atomically(&folder.covisibility(), |out| {
                npy::write_f32(out, (count, count), &plan.covisibility)
            })?;
        }
        if options.extras.contains(&Extra::Transforms) {
            exports::write_transforms(&folder.transforms(), &scene, exports::IN_SCENE_FOLDER)?;
        }
        if options.extras.contains(&Extra::Colmap) {
            exports::write_colmap(&folder.colmap(), &scene)?;
        }
        leftovers::remove_unasked(folder, &options.extras)?;
        leftovers::remove_leftovers(folder, &records)?;
        let digests: Vec<&str> = records.iter().map(|record| record.plan.as_str()).collect();
        let scene_file = SceneFile {
            version: 1,
            id: self.source.id.to_owned(),
            name: self.source.name.to_owned(),
            pixel_centre: options.pixel_centre,
            conventions: conventions(options),
            options: serde_json::to_value(options)
                .map_err(|error| Error::invalid("options", error.to_string()))?,
            plan: plan::digest_of(&digests)?,
            left_out: plan.left_out.clone(),
            warnings: self.warnings_of(&records),
            views: records,
        };
        record::write_json(&folder.record(), &scene_file)?;
        Ok(scene_file)
    }
}

/// What is to be known of finished views: their own warnings, and those of all together.
fn of_records(records: &[ViewRecord]) -> Vec<(String, String)> {
    let mut all: Vec<_> = records.iter().flat_map(|r| r.warnings.clone()).collect();
    let backs = records.iter().map(|record| record.back_faces).sum();
    let fronts = records.iter().map(|record| record.surface).sum();
    all.extend(of_back_faces(backs, fronts).map(|warning| (warning.code, warning.message)));
    let likeness = records
        .iter()
        .map(|r| (format!("view {}", r.id), r.likeness));
    all.extend(warning_of_unlike(likeness).map(|warning| (warning.code, warning.message)));
    let sizes: BTreeSet<(u32, u32)> = records.iter().map(|record| record.size).collect();
    let texts = sizes
        .iter()
        .map(|(width, height)| format!("{width}x{height}"));
    let text = texts.collect::<Vec<_>>().join(", ");
    if sizes.len() > 1 {
        let message = format!(
            "the views have images of {text}: readers stack a scene's images and want one size, which \
             --size gives"
        );
        all.push(("mixed-sizes".to_owned(), message));
    }
    if sizes.iter().any(|&(width, height)| width * 3 != height * 4) {
        let message = format!(
            "some readers cut images to 4:3; these are {text}; --size 2048x1536 or 768x576 is as in \
             the published set"
        );
        all.push(("aspect".to_owned(), message));
    }
    all
}

/// The conventions of the written files, in words.
fn conventions(options: &GenerateOptions) -> BTreeMap<String, String> {
    let centre = match options.pixel_centre {
        PixelCentre::Half => "the centre of the top-left pixel is at (0.5, 0.5)",
        PixelCentre::Integer => "the centre of the top-left pixel is at (0, 0)",
    };
    let texts = [
        ("pixels", centre),
        (
            "extrinsic",
            "world to camera; +X right, +Y down, +Z forward",
        ),
        (
            "depth",
            "along the camera's +Z axis, world units, at pixel centres; 0 = none",
        ),
        (
            "depth_range",
            "minimum, interval = (maximum - minimum) / 128, 128, maximum",
        ),
        (
            "normals",
            "camera frame, facing the camera, unit length; 0 = none",
        ),
        ("mask", "255 where there is rendered surface"),
        (
            "sight",
            "0 = nothing, 32 = no ray, 64 = back of a triangle, 192 = mixed surface, 255 = surface",
        ),
        (
            "occlusion",
            "0 = no surface or outside the source, 128 = occluded, 255 = visible",
        ),
        ("images", "8-bit sRGB"),
        (
            "photographs",
            "resampled into the render's pinhole camera by Lanczos with three lobes before blending",
        ),
        (
            "exports",
            "transforms.json and sparse/0 have pixel centres at (0.5, 0.5) whatever cams/ has",
        ),
        (
            "covisibility",
            "row = reference: fraction of its surface that the column's view sees",
        ),
    ];
    let owned = |(topic, text): (&str, &str)| (topic.to_owned(), text.to_owned());
    texts.into_iter().map(owned).collect()
}
