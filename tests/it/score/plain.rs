//! The plain protocol: two clouds in one frame.

use super::fixture::{Fixture, read, truth};
use super::run;
use crate::support::{mvs_eval, stderr, text, write};
use glam::DVec3;
use mvs_datasets::layout::files;
use mvs_eval::jobs::score::{Protocol, ScoreJob};
use mvs_eval::report::record;
use mvs_eval::score::sample::MeshAs;
use mvs_eval::score::tnt::Profile;

fn fixture() -> (Fixture, ScoreJob) {
    let fixture = Fixture {
        folder: tempfile::tempdir().unwrap(),
    };
    let points = truth(5000);
    let mut raised: Vec<DVec3> = points
        .iter()
        .map(|&point| point + DVec3::Z * 0.01)
        .collect();
    raised.push(DVec3::NAN);
    fixture.put_cloud("truth.ply", points);
    fixture.put_cloud("raised.ply", raised);
    let job = ScoreJob {
        protocol: Protocol::Plain,
        truth: Some(fixture.path("truth.ply")),
        reconstruction: fixture.path("raised.ply"),
        tau: vec![0.02, 0.001],
        out: fixture.path("out"),
        ..ScoreJob::default()
    };
    (fixture, job)
}

#[test]
fn several_tolerances_give_a_list_and_the_first_stands_on_top() {
    let (fixture, job) = fixture();
    let document = run(&job).unwrap();
    assert_eq!((document.tolerance, document.f_score), (0.02, 1.0));
    assert_eq!(document.by_tolerance.len(), 2);
    assert!(document.by_tolerance[1].f_score < 0.1);
    let counts = document.counts.reconstruction;
    assert_eq!(
        (counts.input, counts.non_finite, counts.evaluated),
        (5001, 1, 5000)
    );
    assert_eq!(document.warnings[0].code, "non-finite-points");
    assert!(document.warnings[0].message.contains("1 of 5001"));
    let rows = record::read(read(&fixture.path("out"), "scores.csv").as_bytes()).unwrap();
    assert_eq!(rows.len(), 2);
    assert_eq!(
        (rows[0].threshold, rows[1].threshold),
        (Some(0.001), Some(0.02))
    );
    assert_eq!((rows[1].fscore, rows[1].status.as_str()), (Some(1.0), "ok"));
}

#[test]
fn curves_and_error_clouds_are_the_toolboxs() {
    let (fixture, job) = fixture();
    let document = run(&job).unwrap();
    let out = fixture.path("out");
    let curve = read(&out, "truth.precision.txt");
    let lines: Vec<f64> = curve.lines().map(|line| line.parse().unwrap()).collect();
    assert_eq!(lines.len(), 499);
    // Bin 99 ends at τ.
    assert_eq!(lines[99], document.precision);
    let summary = read(&out, "truth.prf_tau_plotstr.txt");
    let summary: Vec<f64> = summary.lines().map(|line| line.parse().unwrap()).collect();
    assert_eq!(summary, [1.0, 1.0, 1.0, 0.02, 5.0]);
    let errors = files::read_cloud(&out.join("truth.precision.ply")).unwrap();
    assert_eq!(errors.len(), 5000);
    assert!(errors.colors().is_some());
    for name in ["PR_truth_@d_th_0_0200.png", "PR_truth_@d_th_0_0200.svg"] {
        assert!(out.join(name).is_file(), "{name}");
    }
    let header = std::fs::read(out.join("truth.recall.ply")).unwrap();
    assert!(String::from_utf8_lossy(&header[..400]).contains("property float error"));
}

#[test]
fn rows_name_their_inputs_by_sha256() {
    use mvs_eval::provenance::sha256;
    let fixture = Fixture::new(1000);
    run(&fixture.job("out", 0.05)).unwrap();
    let rows = record::read(read(&fixture.path("out"), "scores.csv").as_bytes()).unwrap();
    let row = &rows[0];
    for (found, file) in [
        (&row.rec_sha256, "rec.ply"),
        (&row.truth_sha256, "Synth/Synth.ply"),
        (&row.crop_sha256, "Synth/Synth.json"),
        (&row.log_sha256, "rec.log"),
        (&row.trans_sha256, "Synth/Synth_trans.txt"),
    ] {
        assert_eq!(*found, sha256(&fixture.path(file)).unwrap(), "{file}");
    }
    let (plain, job) = self::fixture();
    run(&job).unwrap();
    let rows = record::read(read(&plain.path("out"), "scores.csv").as_bytes()).unwrap();
    assert!(rows[0].rec_sha256.len() == 64 && rows[0].log_sha256.is_empty());
}

/// One point exactly τ away is no hit; the toolbox's bin at τ, whose edge is τ / 100 · 100, counts it.
#[test]
fn the_plot_says_the_score_where_points_lie_exactly_at_the_tolerance() {
    let (fixture, job) = fixture();
    fixture.put_cloud("truth.ply", vec![DVec3::ZERO]);
    fixture.put_cloud("raised.ply", vec![DVec3::X * 0.007]);
    let job = ScoreJob {
        tau: vec![0.007],
        ..job
    };
    let document = run(&job).unwrap();
    assert_eq!(document.f_score, 0.0);
    let curve = read(&job.out, "truth.precision.txt");
    assert!(curve.lines().nth(99).unwrap().starts_with("1.0"), "no tie");
    let svg = read(&job.out, "PR_truth_@d_th_0_0070.svg");
    assert_eq!(svg.matches(">0.00%<").count(), 3);
}

/// One cloud, thinned in three ways and cropped in one: no two of the voxels share a board or are
/// compared, and the crop stands beside its scene's others with a mark.
#[test]
fn voxels_have_boards_of_their_own_and_crops_are_told_apart() {
    let (fixture, job) = fixture();
    let crop = r#"{"class_name": "SelectionPolygonVolume", "orthogonal_axis": "Z", "axis_min": -9,
        "axis_max": 9, "bounding_polygon": [[-9, -9, 0], [0.1, -9, 0], [0.1, 9, 0], [-9, 9, 0]]}"#;
    write(&fixture.path("crop.json"), crop);
    let score = |out: &str, voxel: Option<f64>, crop: bool| {
        run(&ScoreJob {
            method: Some(out.into()),
            tau: vec![0.02],
            voxel,
            crop: crop.then(|| fixture.path("crop.json")),
            out: fixture.path(&format!("scores/{out}")),
            ..job.clone()
        })
        .unwrap();
    };
    score("as-it-is", None, false);
    score("again", None, false);
    score("coarse", Some(0.2), false);
    score("fine", Some(0.01), false);
    score("cropped", None, true);
    let (scores, report) = (fixture.path("scores"), fixture.path("report"));
    let made = mvs_eval(&["report", text(&scores), "--out", text(&report)]);
    assert_eq!(made.status.code(), Some(0), "{}", stderr(&made));
    let said = stderr(&made);
    assert!(
        said.contains("[not-comparable]") && said.contains("cropped"),
        "{said}"
    );
    let table = read(&report, "leaderboard.md");
    for title in ["plain", "plain · voxel 0.01", "plain · voxel 0.2"] {
        assert!(
            table.contains(&format!("## F-score · {title}\n")),
            "{table}"
        );
    }
    assert!(table.contains("| cropped | – | – | – | "), "{table}");
    assert!(table.contains("| as-it-is | 1 | "), "{table}");
    let compare = |before: &str, more: &[&str]| {
        let (before, after) = (scores.join(before), scores.join("as-it-is"));
        mvs_eval(&[&["compare", text(&before), text(&after)], more].concat())
    };
    for (before, said) in [("coarse", "voxel 0.2"), ("cropped", "crop ")] {
        let refused = compare(before, &[]);
        assert_eq!(refused.status.code(), Some(2), "{}", stderr(&refused));
        assert!(stderr(&refused).contains(said), "{}", stderr(&refused));
    }
    let mixed = compare("cropped", &["--mix"]);
    assert!(mixed.status.code() < Some(2), "{}", stderr(&mixed));
    assert!(stderr(&mixed).contains("[mixed]"), "{}", stderr(&mixed));
}

#[test]
fn what_does_not_go_together_gets_a_sentence() {
    let (_fixture, job) = fixture();
    let said = |job: ScoreJob| run(&job).unwrap_err().to_string();
    let no_tau = ScoreJob {
        tau: Vec::new(),
        ..job.clone()
    };
    assert!(said(no_tau).starts_with("--tau: "));
    let no_truth = ScoreJob {
        truth: None,
        ..job.clone()
    };
    assert!(said(no_truth).starts_with("--truth: "));
    let negative = ScoreJob {
        tau: vec![-1.0],
        ..job.clone()
    };
    assert!(said(negative).contains("above 0, from 1e-150 to 1e150, found -1"));
    let twice = ScoreJob {
        tau: vec![0.1, 0.2, 0.1],
        ..job.clone()
    };
    assert_eq!(
        said(twice),
        "--tau: expected distinct distances, found 0.1 again at place 2"
    );
    let missing = ScoreJob {
        reconstruction: "missing.ply".into(),
        ..job.clone()
    };
    assert!(said(missing).contains("missing.ply"));
    let scene = ScoreJob {
        scene: Some("scene".into()),
        ..job.clone()
    };
    assert!(said(scene).starts_with("--scene: "));
    type Change = (&'static str, fn(&mut ScoreJob));
    let changed: [Change; 8] = [
        ("--methods", |job| job.methods = Some("methods".into())),
        ("--refine", |job| job.refine = true),
        ("--profile", |job| job.profile = Profile::Official),
        ("--seeds", |job| job.seeds = 3),
        ("--one-profile", |job| job.one_profile = true),
        ("--camera-distance", |job| job.camera_distance = 1.0),
        ("--name", |job| job.name = Some("../elsewhere".into())),
        ("--name", |job| job.name = Some("a\\b".into())),
    ];
    for (option, change) in changed {
        let mut job = job.clone();
        change(&mut job);
        assert!(said(job).starts_with(&format!("{option}: ")), "{option}");
    }
}

#[test]
fn the_interval_holds_the_score() {
    let (_fixture, job) = fixture();
    let document = run(&ScoreJob {
        tau: vec![0.0105],
        bootstrap: 200,
        ..job
    })
    .unwrap();
    let interval = document.confidence.unwrap();
    assert!(interval.lower <= document.f_score && document.f_score <= interval.upper);
    assert_eq!(interval.resamples, 200);
}

#[test]
fn every_tolerance_has_an_interval_of_its_own() {
    let (fixture, job) = fixture();
    let document = run(&ScoreJob {
        tau: vec![0.0105, 0.003],
        bootstrap: 100,
        ..job
    })
    .unwrap();
    assert_eq!(document.confidence, document.by_tolerance[0].confidence);
    let rows = record::read(read(&fixture.path("out"), "scores.csv").as_bytes()).unwrap();
    assert_eq!(rows.len(), 2);
    for row in &rows {
        let (f, low, high) = (
            row.fscore.unwrap(),
            row.f_ci_lo.unwrap(),
            row.f_ci_hi.unwrap(),
        );
        assert!(low <= f && f <= high, "{low} {f} {high}");
    }
    assert!(rows[0].f_ci_hi < rows[1].f_ci_lo, "{rows:?}");
}

#[test]
fn a_reconstruction_without_points_scores_zero_and_a_truth_without_points_is_an_error() {
    let (fixture, job) = fixture();
    fixture.put_cloud("empty.ply", Vec::new());
    for (out, voxel) in [("empty", None), ("empty-voxels", Some(0.01))] {
        let document = run(&ScoreJob {
            reconstruction: fixture.path("empty.ply"),
            voxel,
            out: fixture.path(out),
            ..job.clone()
        })
        .unwrap();
        assert_eq!(
            (document.precision, document.recall, document.f_score),
            (0.0, 0.0, 0.0)
        );
        let codes = document
            .warnings
            .iter()
            .map(|warning| warning.code.as_str());
        assert!(codes.clone().any(|code| code == "empty-reconstruction"));
        assert!(document.counts.truth.evaluated > 0);
        let said: Vec<&str> = document
            .warnings
            .iter()
            .map(|w| w.message.as_str())
            .collect();
        assert!(
            said.iter().any(|said| said.contains("has no points")),
            "{said:?}"
        );
        assert!(!said.iter().any(|said| said.contains("units")), "{said:?}");
        assert!(!said.iter().any(|said| said.contains("crop")), "{said:?}");
    }
    let tnt = Fixture::new(1000);
    tnt.put_cloud("rec.ply", Vec::new());
    let document = run(&tnt.job("out", 0.05)).unwrap();
    assert!(
        !document.passed && document.f_score == 0.0,
        "{:?}",
        document.gates
    );
    let report = mvs_eval(&[
        "report",
        text(&fixture.path("empty")),
        "--out",
        text(&fixture.path("report")),
    ]);
    assert!(report.status.success(), "{}", stderr(&report));
    let no_truth = ScoreJob {
        truth: Some(fixture.path("empty.ply")),
        out: fixture.path("none"),
        ..job
    };
    let said = run(&no_truth).unwrap_err().to_string();
    assert!(
        said.contains("expected points of the truth, found none"),
        "{said}"
    );
}

/// Two triangles over [0, 1]² at z = 0 in every mesh format that is read.
#[test]
fn meshes_of_every_format_are_read_on_both_sides_and_recorded() {
    let (fixture, job) = fixture();
    let corners = [
        [0.0f32, 0.0, 0.0],
        [1.0, 0.0, 0.0],
        [1.0, 1.0, 0.0],
        [0.0, 1.0, 0.0],
    ];
    let mut bytes: Vec<u8> = corners
        .iter()
        .flatten()
        .flat_map(|v| v.to_le_bytes())
        .collect();
    bytes.extend([0u16, 1, 2, 0, 2, 3].iter().flat_map(|v| v.to_le_bytes()));
    write(&fixture.path("square.bin"), &bytes);
    let gltf = serde_json::json!({
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "type": "VEC3", "count": 4,
             "min": [0, 0, 0], "max": [1, 1, 0]},
            {"bufferView": 1, "componentType": 5123, "type": "SCALAR", "count": 6}],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": 48},
            {"buffer": 0, "byteOffset": 48, "byteLength": 12}],
        "buffers": [{"uri": "square.bin", "byteLength": 60}],
    });
    write(&fixture.path("square.gltf"), gltf.to_string());
    let lines = corners.map(|[x, y, z]| format!("v {x} {y} {z}\n"));
    write(
        &fixture.path("square.obj"),
        format!("{}f 1 2 3\nf 1 3 4\n", lines.concat()),
    );
    let grid = |i: u32| DVec3::new(f64::from(i % 101), f64::from(i / 101), 0.0) * 0.01;
    fixture.put_cloud("grid.ply", (0..101 * 101).map(grid).collect());
    for (truth, reconstruction) in [
        ("square.obj", "square.gltf"),
        ("square.gltf", "grid.ply"),
        ("grid.ply", "square.obj"),
    ] {
        let score = |mesh_as: MeshAs| {
            run(&ScoreJob {
                truth: Some(fixture.path(truth)),
                reconstruction: fixture.path(reconstruction),
                tau: vec![0.05],
                mesh_as,
                out: fixture.path(&format!("{truth}-{reconstruction}-{mesh_as}")),
                ..job.clone()
            })
            .unwrap()
        };
        let sampled = score(MeshAs::Area);
        assert!(sampled.f_score > 0.99, "{}", sampled.f_score);
        assert_eq!(sampled.mesh_sampling, Some(MeshAs::Area));
        let warned = |code: &str| sampled.warnings.iter().any(|warning| warning.code == code);
        assert_eq!(warned("truth-is-mesh"), truth != "grid.ply");
        let vertices = score(MeshAs::Vertices);
        let coarse = vertices
            .warnings
            .iter()
            .find(|w| w.code == "mesh-too-coarse");
        assert!(coarse.is_some(), "{:?}", vertices.warnings);
    }
}

/// A cloud that is triangulated in part is not judged by its few faces without a word.
#[test]
fn vertices_of_no_face_are_told_of() {
    let (fixture, job) = fixture();
    let corners = (0..100).map(|i| {
        format!(
            "{} {} 0\n",
            0.1 * f64::from(i % 10),
            0.1 * f64::from(i / 10)
        )
    });
    let put = |name: &str, faces: &[[u32; 3]]| {
        let lines = faces.iter().map(|[a, b, c]| format!("3 {a} {b} {c}\n"));
        let text = format!(
            "ply\nformat ascii 1.0\nelement vertex 100\nproperty float x\nproperty float y\nproperty float z\n\
             element face {}\nproperty list uchar int vertex_indices\nend_header\n{}{}",
            faces.len(),
            corners.clone().collect::<String>(),
            lines.collect::<String>()
        );
        write(&fixture.path(name), text);
    };
    put("few.ply", &[[0, 1, 10]]);
    let all: Vec<[u32; 3]> = (0..98).map(|i| [i, i + 1, i + 2]).collect();
    put("all.ply", &all);
    let said = |name: &str, mesh_as: MeshAs| {
        let document = run(&ScoreJob {
            reconstruction: fixture.path(name),
            mesh_as,
            out: fixture.path(&format!("{name}-{mesh_as}")),
            ..job.clone()
        });
        let warnings = document.unwrap().warnings;
        let loose = warnings
            .iter()
            .find(|warning| warning.code == "loose-vertices");
        loose.map(|warning| warning.message.clone())
    };
    let few = said("few.ply", MeshAs::Area).unwrap();
    assert!(
        few.contains("97 of 100 vertices are corners of no face"),
        "{few}"
    );
    assert_eq!(said("few.ply", MeshAs::Vertices), None);
    assert_eq!(said("all.ply", MeshAs::Area), None);
}

#[test]
fn a_cloud_in_other_units_is_warned_of() {
    let (fixture, job) = fixture();
    let in_millimetres = truth(5000).into_iter().map(|point| point * 1000.0);
    fixture.put_cloud("millimetres.ply", in_millimetres.collect());
    let document = run(&ScoreJob {
        reconstruction: fixture.path("millimetres.ply"),
        ..job.clone()
    })
    .unwrap();
    assert_eq!(document.f_score, 0.0);
    let warned = document.warnings.iter().find(|w| w.code == "nothing-right");
    let said = &warned.unwrap().message;
    assert!(said.contains("units look like millimetres"), "{said}");
    // Already before the search, which takes long where clouds lie far apart.
    let output = mvs_eval(&[
        "score",
        "--truth",
        text(job.truth.as_deref().unwrap()),
        "--reconstruction",
        text(&fixture.path("millimetres.ply")),
        "--tau",
        "0.05",
        "--out",
        text(&fixture.path("heard")),
    ]);
    let heard = stderr(&output);
    assert!(
        heard.contains("scoring; units look like millimetres"),
        "{heard}"
    );
    let right = run(&ScoreJob {
        out: fixture.path("right"),
        ..job
    })
    .unwrap();
    assert!(right.warnings.iter().all(|w| w.code != "nothing-right"));
}
