//! render → estimate → fuse → align → score on a fixture scene, each stage summed up in numbers.

use glam::{DMat4, DQuat, DVec2, DVec3};
use mvs_datasets::format::log::LogPose;
use mvs_datasets::scene::{Camera, DepthMap, Raster, View};
use mvs_datasets::synthetic::{DepthNoise, SceneKind, SyntheticOptions, SyntheticScene};
use mvs_eval::fuse::{self, Estimate, FuseMode, FuseOptions};
use mvs_eval::progress::Silent;
use mvs_eval::render::{BackFaces, RenderOptions, Renderer};
use mvs_eval::score::cameras::{self, Trajectories};
use mvs_eval::score::plain::{self, Preparation};
use mvs_eval::score::tnt::{self, Inputs, Options, Profile, Start};
use mvs_eval::score::{Evaluation, FinitePoints};
use mvs_metrics::Tolerance;
use mvs_metrics::crop::Prism;

/// The stages in their order.
pub(super) const STAGES: [&str; 5] = ["render", "estimate", "fuse", "align", "score"];

/// One number of a run, a row of the file.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub(super) struct Number {
    pub(super) scene: String,
    pub(super) stage: String,
    /// Fusion mode and scoring profile, where they matter.
    pub(super) variant: String,
    pub(super) quantity: String,
    pub(super) value: f64,
}

/// What is done to the values between two stages on purpose.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Fault {
    /// Depth belongs to places half a pixel off.
    HalfPixel,
    /// The noise is a hundredth larger.
    MoreNoise,
    /// Fusion lets a little more pass.
    LooseGate,
    /// ICP starts a little elsewhere.
    ShiftedStart,
    /// The plain score averages over voxels of τ.
    WideVoxel,
}

/// A fixture scene with what scoring it needs.
struct Setting {
    scene: SyntheticScene,
    /// τ: about a pixel's width at the scene's distance.
    tau: f64,
    crop: Prism,
}

impl Setting {
    fn new(options: SyntheticOptions) -> Self {
        let tau = match options.kind {
            SceneKind::Object | SceneKind::Thin | SceneKind::Tabletop => 0.02,
            SceneKind::Facade => 0.05,
            SceneKind::Outdoor => 0.3,
        };
        let scene = SyntheticScene::new(options.clone()).unwrap();
        let bounds = scene.mesh().bounds();
        let margin = DVec3::splat(5.0 * tau);
        let (mut low, mut high) = (bounds.min - margin, bounds.max + margin);
        if options.kind == SceneKind::Outdoor {
            // The far background is seen but not judged.
            low = low.max(DVec3::new(-30.0, -15.0, low.z));
            high = high.min(DVec3::new(30.0, 45.0, high.z));
        }
        let corners = [
            (low.x, low.y),
            (high.x, low.y),
            (high.x, high.y),
            (low.x, high.y),
        ];
        let crop = Prism::new(2, (low.z, high.z), &corners.map(DVec2::from)).unwrap();
        Self { scene, tau, crop }
    }

    fn views(&self) -> &[View] {
        self.scene.scene().views()
    }
}

/// Collects the numbers of a stage.
struct Numbers {
    scene: String,
    all: Vec<Number>,
}

impl Numbers {
    fn put(&mut self, stage: &str, variant: &str, quantity: &str, value: f64) {
        assert!(
            STAGES.contains(&stage) && value.is_finite(),
            "{stage} {variant} {quantity}"
        );
        self.all.push(Number {
            scene: self.scene.clone(),
            stage: stage.to_owned(),
            variant: variant.to_owned(),
            quantity: quantity.to_owned(),
            value,
        });
    }
}

/// Runs the whole pipeline on a fixture scene.
pub(super) fn run(name: &str, options: SyntheticOptions, fault: Option<Fault>) -> Vec<Number> {
    let setting = Setting::new(options);
    let mut numbers = Numbers {
        scene: name.to_owned(),
        all: Vec::new(),
    };
    let rendered = render(&setting, fault, &mut numbers);
    let estimates = estimate(&setting, &rendered, fault, &mut numbers);
    let truth = setting.scene.sample_surface(0.5 * setting.tau).unwrap();
    let truth = FinitePoints::new(truth.into_positions());
    let starts = [Profile::Official, Profile::Strict].map(|profile| start(&setting, profile));
    for mode in FuseMode::ALL {
        let variant = format!("{mode:?}").to_lowercase();
        let cloud = fused(&estimates, mode, &variant, fault, &mut numbers);
        score_plain(&setting, (&cloud, &truth), &variant, fault, &mut numbers);
        for (profile, start) in [Profile::Official, Profile::Strict].into_iter().zip(starts) {
            let start = match fault {
                Some(Fault::ShiftedStart) => {
                    DMat4::from_translation(DVec3::X * (0.3 * setting.tau)) * start
                }
                _ => start,
            };
            let variant = format!("{variant} {profile}");
            score_aligned(
                &setting,
                (&cloud, &truth),
                (profile, start),
                &variant,
                &mut numbers,
            );
        }
    }
    numbers.all
}

fn render(setting: &Setting, fault: Option<Fault>, numbers: &mut Numbers) -> Vec<DepthMap> {
    let renderer = Renderer::new(setting.scene.mesh()).unwrap();
    let options = RenderOptions {
        samples: 1,
        back_faces: BackFaces::Valid,
        ..RenderOptions::default()
    };
    let one = |view: &View| {
        let mut view = view.clone();
        if fault == Some(Fault::HalfPixel) {
            let (camera, half) = (view.camera, DVec2::splat(0.5));
            let (width, height) = (camera.width(), camera.height());
            view.camera =
                Camera::new(width, height, camera.focal(), camera.center() + half).unwrap();
        }
        renderer.render(&view, &options).unwrap().depth
    };
    let maps: Vec<DepthMap> = setting.views().iter().map(one).collect();
    sum_up(&maps, "render", numbers);
    maps
}

/// How much of the maps has depth, how deep it is, and where that lies in the images.
fn sum_up(maps: &[DepthMap], stage: &str, numbers: &mut Numbers) {
    let (mut count, mut sum, mut across, mut down) = (0.0, 0.0, 0.0, 0.0);
    for map in maps {
        for row in 0..map.height() {
            for column in 0..map.width() {
                let depth = f64::from(map.get(column, row));
                count += f64::from(u8::from(depth > 0.0));
                sum += depth;
                across += depth * (f64::from(column) + 0.5);
                down += depth * (f64::from(row) + 0.5);
            }
        }
    }
    numbers.put(stage, "", "pixels with depth", count);
    numbers.put(stage, "", "mean depth", sum / count);
    numbers.put(stage, "", "column by depth", across / sum);
    numbers.put(stage, "", "row by depth", down / sum);
}

fn estimate(
    setting: &Setting,
    rendered: &[DepthMap],
    fault: Option<Fault>,
    numbers: &mut Numbers,
) -> Vec<Estimate> {
    let mut noise = DepthNoise::default();
    if fault == Some(Fault::MoreNoise) {
        noise.relative_sigma *= 1.01;
    }
    let scene = setting.scene.scene();
    let one = |(index, depth): (usize, &DepthMap)| {
        let (depth, confidence) = setting.scene.worsened(index, depth, &noise);
        let sources = scene.sources_of(index).iter();
        Estimate {
            view: scene.views()[index].clone(),
            depth,
            confidence: Some(confidence),
            image: None,
            sources: sources
                .filter_map(|source| scene.index_of(source.id))
                .collect(),
        }
    };
    let estimates: Vec<Estimate> = rendered.iter().enumerate().map(one).collect();
    let maps: Vec<DepthMap> = estimates.iter().map(|e| e.depth.clone()).collect();
    sum_up(&maps, "estimate", numbers);
    let errors = estimates
        .iter()
        .zip(rendered)
        .flat_map(|(estimate, truth)| {
            let pairs = estimate.depth.values().iter().zip(truth.values());
            let both = pairs.filter(|&(&found, &truth)| found > 0.0 && truth > 0.0);
            both.map(|(&found, &truth)| (f64::from(found) / f64::from(truth) - 1.0).abs())
        });
    let median = mvs_metrics::stats::median(&errors.collect::<Vec<_>>()).unwrap();
    // In millionths, so that a hundredth of it is seen.
    numbers.put("estimate", "", "median relative error, 1e-6", 1e6 * median);
    let confidences = estimates.iter().filter_map(|e| e.confidence.as_ref());
    let sum: f64 = confidences
        .flat_map(Raster::values)
        .map(|&c| f64::from(c))
        .sum();
    numbers.put("estimate", "", "sum of confidences", sum);
    estimates
}

fn fused(
    estimates: &[Estimate],
    mode: FuseMode,
    variant: &str,
    fault: Option<Fault>,
    numbers: &mut Numbers,
) -> Vec<DVec3> {
    let mut options = FuseOptions::of(mode);
    if fault == Some(Fault::LooseGate) {
        options.max_pixel_error *= 1.25;
        options.max_depth_error *= 1.25;
        options.max_disparity_error *= 1.25;
    }
    let fused = fuse::fuse(estimates, &options, &Silent).unwrap();
    let counts = fused.counts;
    assert_eq!(counts.accounted(), counts.pixels);
    numbers.put("fuse", variant, "points", fused.cloud.len() as f64);
    numbers.put("fuse", variant, "inconsistent", counts.inconsistent as f64);
    numbers.put("fuse", variant, "contradicted", counts.contradicted as f64);
    let mean = fused.cloud.positions().iter().sum::<DVec3>() / fused.cloud.len() as f64;
    for (axis, value) in ["mean x", "mean y", "mean z"]
        .into_iter()
        .zip(mean.to_array())
    {
        numbers.put("fuse", variant, axis, value);
    }
    fused.cloud.into_positions()
}

fn score_plain(
    setting: &Setting,
    (cloud, truth): (&[DVec3], &FinitePoints),
    mode: &str,
    fault: Option<Fault>,
    numbers: &mut Numbers,
) {
    let share = if fault == Some(Fault::WideVoxel) {
        1.0
    } else {
        0.5
    };
    let preparation = Preparation {
        crop: Some(setting.crop.clone()),
        voxel: Some(share * setting.tau),
    };
    let cloud = FinitePoints::new(cloud.to_vec());
    let evaluation = plain::evaluate(&cloud, None, truth, &preparation).unwrap();
    put_score(&evaluation, setting.tau, &format!("{mode} plain"), numbers);
}

fn put_score(evaluation: &Evaluation, tau: f64, variant: &str, numbers: &mut Numbers) {
    let tolerance = Tolerance::new(tau).unwrap();
    let score = evaluation.score(tolerance);
    let (reconstruction, truth) = evaluation.counts(tolerance);
    for (quantity, value) in [
        ("precision", score.precision()),
        ("recall", score.recall()),
        ("f_score", score.f_score()),
        ("reconstruction judged", reconstruction.evaluated as f64),
        ("reconstruction within", reconstruction.within as f64),
        ("truth judged", truth.evaluated as f64),
        ("truth within", truth.within as f64),
    ] {
        numbers.put("score", variant, quantity, value);
    }
}

/// From the frame of a reconstruction to that of the truth.
fn truth_from_own() -> DMat4 {
    DMat4::from_scale_rotation_translation(
        DVec3::splat(2.5),
        DQuat::from_rotation_z(0.7),
        DVec3::new(1.0, -2.0, 0.5),
    )
}

/// Where the cameras, each a little off, say that ICP starts.
fn start(setting: &Setting, profile: Profile) -> DMat4 {
    let pose = |centre: DVec3, index: usize| LogPose {
        metadata: [index as i64, index as i64, 0],
        world_from_cam: DMat4::from_translation(centre),
    };
    let centres = || {
        setting
            .views()
            .iter()
            .map(|view| view.pose.center_in_world())
            .enumerate()
    };
    let off = |index: usize| {
        // Any small amounts that differ: multiples of an irrational number, less their integer part.
        let share = |k: usize| (0.618_033_988_749_894_9 * (3 * index + k) as f64).fract() - 0.5;
        DVec3::new(share(0), share(1), share(2)) * setting.tau
    };
    let own_from_truth = truth_from_own().inverse();
    let trajectories = Trajectories {
        given: centres()
            .map(|(index, centre)| {
                pose(own_from_truth.transform_point3(centre + off(index)), index)
            })
            .collect(),
        reference: centres()
            .map(|(index, centre)| pose(centre, index))
            .collect(),
        mapping: None,
        named: false,
        truth_from_reference: DMat4::IDENTITY,
    };
    let fit = cameras::fit(&trajectories, profile, 4.0 * setting.tau, 0).unwrap();
    fit.fit.target_from_source
}

fn score_aligned(
    setting: &Setting,
    (cloud, truth): (&[DVec3], &FinitePoints),
    (profile, start): (Profile, DMat4),
    variant: &str,
    numbers: &mut Numbers,
) {
    let own_from_truth = truth_from_own().inverse();
    let own = cloud
        .iter()
        .map(|&point| own_from_truth.transform_point3(point));
    let inputs = Inputs {
        reconstruction: FinitePoints::new(own.collect()),
        truth: truth.clone(),
        crop: setting.crop.clone(),
        tolerance: Tolerance::new(setting.tau).unwrap(),
        start: Start::Refined(start),
    };
    let options = Options {
        profile,
        camera_distance: 4.0 * setting.tau,
        seed: 0,
    };
    let motion = tnt::align(&inputs, &options).unwrap().motion;
    let found = motion.truth_from_reconstruction;
    let last = motion.stages.last().unwrap();
    numbers.put("align", variant, "scale", tnt::scale_of(found));
    for (axis, value) in ["x", "y", "z"].into_iter().zip(found.w_axis.to_array()) {
        numbers.put("align", variant, axis, value);
    }
    numbers.put("align", variant, "fitness", last.fitness);
    let evaluation = tnt::evaluate(&inputs, found).unwrap();
    put_score(&evaluation, setting.tau, variant, numbers);
}
