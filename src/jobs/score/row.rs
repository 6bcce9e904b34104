//! A score as the rows of `scores.csv`.

use super::document::{AtTolerance, Protocol, ScoreDocument};
use crate::report::record::Record;
use mvs_datasets::layout::tnt::known_tolerance;

/// One row per tolerance.
pub(super) fn records(document: &ScoreDocument) -> Vec<Record> {
    let rows = document.by_tolerance.iter();
    rows.map(|at| record(document, at)).collect()
}

fn record(document: &ScoreDocument, at: &AtTolerance) -> Record {
    let (reconstruction, truth) = (at.counts.reconstruction, at.counts.truth);
    let confidence = at.confidence;
    let distances = document.distances;
    let alignment = &document.alignment;
    let trajectory = alignment.trajectory.as_ref();
    let last = alignment.icp.last();
    let mean = |a: Option<f64>, b: Option<f64>| Some((a? + b?) / 2.0);
    let updates = alignment.icp.iter().map(|stage| stage.iterations as u64);
    let inputs = &document.inputs;
    let hash = |hash: &Option<String>| hash.clone().unwrap_or_default();
    // The edge of the voxels makes two procedures of the plain protocol; a profile brings its own.
    let voxel = document.voxel.map(|edge| format!("voxel {edge}"));
    let profile = document
        .profile
        .map(|profile| profile.to_string())
        .or(voxel);
    let mesh = document.mesh_sampling.map(|mesh_as| mesh_as.to_string());
    Record {
        protocol: document.protocol.to_string(),
        profile: profile.unwrap_or_default(),
        method: document.method.clone(),
        split: split_of(document.protocol, &document.scene).into(),
        scene: document.scene.clone(),
        threshold: Some(at.tolerance),
        unit: unit_of(document.protocol, &document.scene).into(),
        precision: Some(at.precision),
        recall: Some(at.recall),
        fscore: Some(at.f_score),
        acc_mean: distances.reconstruction_mean,
        acc_median: distances.reconstruction_median,
        comp_mean: distances.truth_mean,
        comp_median: distances.truth_median,
        overall: mean(distances.reconstruction_mean, distances.truth_mean),
        f_ci_lo: confidence.map(|interval| interval.lower),
        f_ci_hi: confidence.map(|interval| interval.upper),
        n_rec_in: Some(reconstruction.input as u64),
        n_rec_crop: Some(reconstruction.cropped as u64),
        n_rec_eval: Some(reconstruction.evaluated as u64),
        n_truth_in: Some(truth.input as u64),
        n_truth_crop: Some(truth.cropped as u64),
        n_truth_eval: Some(truth.evaluated as u64),
        align: alignment.source.name().into(),
        align_scale: Some(alignment.scale),
        traj_inliers: trajectory.map(|report| report.inliers as u64),
        traj_rmse: trajectory.map(|report| report.rmse),
        icp_fitness: last.map(|stage| stage.fitness),
        icp_rmse: last.map(|stage| stage.rmse),
        icp_iterations: last.map(|_| updates.sum()),
        mesh_sampling: mesh.unwrap_or_default(),
        seed: Some(document.seed),
        status: status_of(document),
        tool_version: crate::provenance::VERSION.into(),
        rec_sha256: hash(&inputs.reconstruction),
        truth_sha256: hash(&inputs.truth),
        crop_sha256: hash(&inputs.crop),
        log_sha256: hash(&inputs.log),
        trans_sha256: hash(&inputs.transform),
        ..Record::default()
    }
}

/// The scenes of Tanks and Temples are in metres; other truths are in whatever unit they came in.
pub(super) fn unit_of(protocol: Protocol, scene: &str) -> &'static str {
    match protocol {
        Protocol::Tnt if known_tolerance(scene).is_some() => "m",
        Protocol::Tnt | Protocol::Plain => "world",
    }
}

/// The scenes that bring their own τ are the training set; others are not known.
pub(super) fn split_of(protocol: Protocol, scene: &str) -> &'static str {
    match protocol {
        Protocol::Tnt if known_tolerance(scene).is_some() => "training",
        Protocol::Tnt | Protocol::Plain => "",
    }
}

/// `ok`, or the failed gates.
fn status_of(document: &ScoreDocument) -> String {
    let failed = document.gates.iter().filter(|gate| !gate.passed);
    let failed: Vec<&str> = failed.map(|gate| gate.code.as_str()).collect();
    if failed.is_empty() {
        return "ok".to_owned();
    }
    format!("gate: {}", failed.join(" "))
}
