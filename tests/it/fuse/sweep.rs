//! The same maps with a grid of parameters.

use super::*;
use crate::support::{mvs_eval, stderr, text, write};
use mvs_datasets::format::ply::{self, PlyOptions};
use mvs_eval::jobs::score::{self, ScoreJob};

#[test]
fn a_sweep_reads_once_and_each_line_is_what_fusing_gives() {
    let scene = scene();
    let folder = tempfile::tempdir().unwrap();
    let fuse_job = write_scene(&scene, Some(&DepthNoise::default()), folder.path());
    let truth = folder.path().join("truth.ply");
    let mut plain = fuse_job.clone();
    plain.depths = folder.path().join("exact");
    for (index, view) in scene.scene().views().iter().enumerate() {
        let path = plain.depths.join(mvsnet::file_name(view.id, ".pfm"));
        let depth = scene.depth(index);
        files::write_atomically(&path, |out| pfm::write_gray(out, depth.raster())).unwrap();
    }
    (plain.out, plain.confidence) = (truth.clone(), Vec::new());
    fuse(&plain, false).unwrap();
    let job = SweepJob {
        out: folder.path().join("sweep.csv"),
        pixel_errors: vec![0.25, 1.0],
        min_sources: vec![2, 4],
        min_confidences: vec![0.5],
        truth: Some(truth),
        tau: 0.02,
        fuse: fuse_job.clone(),
    };
    let warnings = Warnings::default();
    let context = Context {
        progress: &Silent,
        warnings: &warnings,
        force: false,
    };
    let outcome = sweep_job::run(&job, &context).unwrap();
    assert_eq!(outcome.rows.len(), 4);
    for row in &outcome.rows {
        let mut one = fuse_job.clone();
        one.fuse.max_pixel_error = row.max_pixel_error.unwrap();
        one.fuse.min_sources = row.min_sources.unwrap();
        one.fuse.min_confidence = 0.5;
        let alone = fuse(&one, true).unwrap();
        assert_eq!((alone.points, alone.counts), (row.points, row.counts));
        let score = row.score.unwrap();
        assert!(
            score.f_score() > 0.5 && score.precision() > 0.9,
            "{score:?}"
        );
    }
    let points = |at: usize| outcome.rows[at].points;
    // Confidence outermost, pixel error innermost: looser gates and fewer sources give more.
    assert!(points(0) < points(1) && points(2) < points(0) && points(3) < points(1));
    let csv = files::read_text(&job.out).unwrap();
    assert_eq!(csv.lines().count(), 5);
    assert!(
        csv.lines().nth(1).unwrap().starts_with("0.5,2,0.25,"),
        "{csv}"
    );
    let (low, high) = outcome.fscore.unwrap();
    assert!(low < high);
    assert!(
        sweep_job::run(&job, &context).is_err(),
        "kept without --force"
    );
    // With a crop it is the truth in the crop that counts, as for the score of the cloud alone.
    let mut cropped = SweepJob {
        pixel_errors: vec![1.0],
        min_sources: vec![2],
        out: folder.path().join("cropped.csv"),
        ..job.clone()
    };
    let crop = folder.path().join("crop.json");
    let square = r#"[[-0.4,-0.4,0],[0.4,-0.4,0],[0.4,0.4,0],[-0.4,0.4,0]]"#;
    let volume =
        r#""class_name":"SelectionPolygonVolume","orthogonal_axis":"Z","axis_min":-9,"axis_max":9"#;
    let content =
        format!(r#"{{{volume},"bounding_polygon":{square},"version_major":1,"version_minor":0}}"#);
    files::write_atomically(&crop, |out| out.write_all(content.as_bytes())).unwrap();
    cropped.fuse.crop = Some(crop.clone());
    let row = sweep_job::run(&cropped, &context).unwrap().rows.remove(0);
    let mut one = cropped.fuse.clone();
    (
        one.fuse.max_pixel_error,
        one.fuse.min_sources,
        one.fuse.min_confidence,
    ) = (1.0, 2, 0.5);
    one.out = folder.path().join("one.ply");
    fuse(&one, true).unwrap();
    let mesh = folder.path().join("mesh.ply");
    files::write_atomically(&mesh, |out| {
        ply::write_mesh(out, scene.mesh(), &PlyOptions::default())
    })
    .unwrap();
    assert!(row.points < outcome.rows[1].points / 2);
    // A mesh is sampled, as `score` samples it.
    for (name, truth) in [("score", job.truth), ("score-mesh", Some(mesh))] {
        let alone = score::run(
            &ScoreJob {
                truth: truth.clone(),
                reconstruction: one.out.clone(),
                crop: Some(crop.clone()),
                voxel: Some(0.01),
                tau: vec![0.02],
                out: folder.path().join(name),
                ..ScoreJob::default()
            },
            &context,
        )
        .unwrap();
        let again = SweepJob {
            truth,
            out: folder.path().join(format!("{name}.csv")),
            ..cropped.clone()
        };
        let row = sweep_job::run(&again, &context).unwrap().rows.remove(0);
        let found = row.score.unwrap();
        assert_eq!(
            (found.precision(), found.recall()),
            (alone.precision, alone.recall),
            "{name}"
        );
        assert!(alone.recall > 0.5, "{name}");
    }
}

#[test]
fn a_flag_is_the_one_value_of_its_axis() {
    let scene = scene();
    let folder = tempfile::tempdir().unwrap();
    let job = write_scene(&scene, None, folder.path());
    let table = folder.path().join("sweep.csv");
    let sweep = |more: &[&str]| {
        let fixed = [
            "fuse",
            text(&job.scene),
            "--depths",
            text(&job.depths),
            "--sweep",
        ];
        let out = ["--out", text(&table), "--force"];
        mvs_eval(&[&fixed[..], &out, more].concat())
    };
    let made = sweep(&["--max-pixel-error", "0.7", "--sweep-min-sources", "2,4"]);
    assert_eq!(made.status.code(), Some(0), "{}", stderr(&made));
    let csv = files::read_text(&table).unwrap();
    let axes = csv
        .lines()
        .skip(1)
        .map(|line| &line[..line.match_indices(',').nth(2).unwrap().0]);
    assert_eq!(
        axes.collect::<Vec<_>>(),
        [",2,0.7", ",4,0.7"],
        "no confidence maps"
    );
    let both = sweep(&["--min-sources", "3", "--sweep-min-sources", "2,4"]);
    assert_eq!(both.status.code(), Some(2));
    assert!(
        stderr(&both).contains("--sweep-min-sources: says the same as --min-sources"),
        "{}",
        stderr(&both)
    );
}

#[test]
fn a_sweep_refuses_what_only_a_cloud_has_and_varies_what_the_mode_asks_for() {
    let scene = scene();
    let folder = tempfile::tempdir().unwrap();
    let fuse_job = write_scene(&scene, None, folder.path());
    let mut job = SweepJob {
        out: folder.path().join("sweep.csv"),
        fuse: fuse_job,
        ..SweepJob::default()
    };
    let rows = |job: &SweepJob| {
        let warnings = Warnings::default();
        let context = Context {
            progress: &Silent,
            warnings: &warnings,
            force: true,
        };
        sweep_job::run(job, &context).map(|outcome| outcome.rows)
    };
    job.fuse.vis = true;
    let error = rows(&job).unwrap_err().to_string();
    assert!(error.contains("--vis"), "{error}");
    job.fuse.vis = false;
    job.fuse.fuse = FuseOptions::of(FuseMode::Dynamic);
    type Change = (&'static str, &'static str, fn(&mut SweepJob));
    let changes: [Change; 4] = [
        ("--sweep-min-sources", "dynamic", |job| {
            job.min_sources = vec![2, 4];
        }),
        ("--sweep-pixel-error", "dynamic", |job| {
            job.pixel_errors = vec![0.7];
        }),
        ("--sweep-min-confidence", "without --confidence", |job| {
            job.min_confidences = vec![0.5];
        }),
        ("--sweep-pixel-error", "0.5 twice", |job| {
            job.fuse.fuse = FuseOptions::of(FuseMode::Geo);
            job.pixel_errors = vec![0.5, 1.0, 0.5];
        }),
    ];
    for (flag, part, change) in changes {
        let mut job = job.clone();
        change(&mut job);
        let error = rows(&job).unwrap_err().to_string();
        assert!(error.starts_with(flag) && error.contains(part), "{error}");
    }
    assert_eq!(rows(&job).unwrap().len(), 1);
    job.fuse.fuse = FuseOptions::of(FuseMode::Geo);
    let in_memory = rows(&job).unwrap();
    assert_eq!(in_memory.len(), 9);
    // With room for no map all of them are read again, with the same result.
    job.fuse.memory = Some(0);
    assert_eq!(rows(&job).unwrap(), in_memory);
}

/// Where files cannot grow, as on a full disk, a table that is there stays whole with its `run.toml`.
#[cfg(unix)]
#[test]
fn a_table_that_cannot_be_written_leaves_the_one_before_it() {
    let scene = scene();
    let folder = tempfile::tempdir().unwrap();
    let job = write_scene(&scene, None, folder.path());
    let (table, run_file) = (
        folder.path().join("sweep.csv"),
        folder.path().join("sweep.run.toml"),
    );
    let sweep = |blocks: &str, errors: &str| {
        let command = format!("trap '' XFSZ; ulimit -f {blocks}; exec \"$0\" \"$@\"");
        let mut sh = std::process::Command::new("sh");
        sh.args(["-c", &command])
            .arg(assert_cmd::cargo::cargo_bin!("mvs-eval"))
            .args(["fuse", text(&job.scene), "--depths", text(&job.depths)])
            .args(["--mode", "geo", "--sweep", "--force", "--out", text(&table)])
            .args(["--sweep-min-sources", "2", "--sweep-pixel-error", errors]);
        sh.output().unwrap()
    };
    let first = sweep("unlimited", "0.5,1");
    assert_eq!(first.status.code(), Some(0), "{}", stderr(&first));
    let before = [&table, &run_file].map(|path| std::fs::read(path).unwrap());
    let many: Vec<String> = (1..40)
        .map(|at| format!("{}", 0.1 * f64::from(at)))
        .collect();
    let second = sweep("1", &many.join(","));
    assert_eq!(second.status.code(), Some(2), "{}", stderr(&second));
    assert!(stderr(&second).contains("sweep.csv"), "{}", stderr(&second));
    assert_eq!(
        [&table, &run_file].map(|path| std::fs::read(path).unwrap()),
        before
    );
}

/// As `fuse` says of what it makes, whatever the combination.
#[test]
fn a_sweep_without_points_says_why_and_depths_in_other_units_are_said() {
    let scene = scene();
    let folder = tempfile::tempdir().unwrap();
    let fuse_job = write_scene(&scene, Some(&DepthNoise::default()), folder.path());
    let mut job = SweepJob {
        out: folder.path().join("sweep.csv"),
        fuse: fuse_job.clone(),
        ..SweepJob::default()
    };
    let sweep = |job: &SweepJob| {
        let warnings = Warnings::default();
        let context = Context {
            progress: &Silent,
            warnings: &warnings,
            force: true,
        };
        let outcome = sweep_job::run(job, &context);
        let codes = warnings.sorted().into_iter().map(|warning| warning.code);
        (outcome, codes.collect::<Vec<String>>())
    };
    job.fuse.fuse.min_depth = 1e6;
    let message = sweep(&job).0.unwrap_err().to_string();
    assert!(
        message.contains("no pixel of 12 depth maps passed"),
        "{message}"
    );
    assert!(!job.out.exists());
    job.fuse.fuse.min_depth = 0.0;
    job.tau = 0.1;
    let message = sweep(&job).0.unwrap_err().to_string();
    assert!(message.contains("--tau: needs --truth"), "{message}");
    job.tau = 0.0;
    assert!(sweep(&job).1.is_empty());
    for view in scene.scene().views() {
        change_map(&fuse_job.depths, view.id, |_, depth| depth * 1000.0);
    }
    assert_eq!(sweep(&job).1, ["depth-units"]);
}

/// The grid of a sweep before, changed by flags.
#[test]
fn a_sweep_takes_the_options_of_a_sweep() {
    let scene = scene();
    let folder = tempfile::tempdir().unwrap();
    let fuse_job = write_scene(&scene, None, folder.path());
    let [first, second] = ["a", "b"].map(|name| folder.path().join(name).with_extension("csv"));
    let job = SweepJob {
        out: first.clone(),
        pixel_errors: vec![0.25, 0.5],
        min_sources: vec![2],
        fuse: fuse_job,
        ..SweepJob::default()
    };
    let warnings = Warnings::default();
    let context = Context {
        progress: &Silent,
        warnings: &warnings,
        force: false,
    };
    sweep_job::run(&job, &context).unwrap();
    let run = first.with_extension("run.toml");
    let again = |out: &Path, more: &[&str]| {
        let arguments = [
            "fuse",
            "--sweep",
            "--config",
            text(&run),
            "--out",
            text(out),
        ];
        let output = mvs_eval(&[&arguments[..], more].concat());
        assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
        files::read_text(out).unwrap()
    };
    let expected = files::read_text(&first).unwrap();
    assert_eq!(again(&second, &[]), expected);
    // How a cloud is written does not matter to a table, whatever a run of the version before says.
    let of_before = files::read_text(&run).unwrap();
    let basic = "properties = \"basic\"";
    assert!(of_before.contains(basic), "{of_before}");
    write(&run, of_before.replace(basic, "properties = \"full\""));
    let replayed = folder.path().join("r.csv");
    let output = mvs_eval(&["replay", text(&run), "--out", text(&replayed)]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    assert_eq!(files::read_text(&replayed).unwrap(), expected);
    let full = [
        "fuse",
        "--sweep",
        "--config",
        text(&run),
        "--properties",
        "full",
    ];
    let said = stderr(&mvs_eval(
        &[&full[..], &["--out", text(&replayed), "--force"]].concat(),
    ));
    assert!(
        said.contains("--properties: expected none with --sweep"),
        "{said}"
    );
    let more = again(
        &folder.path().join("c.csv"),
        &["--sweep-min-sources", "2,4"],
    );
    assert!(
        more.starts_with(&expected) && more.lines().count() == 5,
        "{more}"
    );
}
