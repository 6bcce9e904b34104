//! Flags beside a configuration file, and replays.

use super::*;
use crate::support::{mvs_eval, stderr, text, write};

/// What `fuse` writes with these arguments.
fn cloud(job: &FuseJob, more: &[&str]) -> (Vec<u8>, String) {
    let mut arguments = vec!["fuse", text(&job.scene), "--depths", text(&job.depths)];
    arguments.extend(["--out", text(&job.out), "--force"]);
    arguments.extend(more);
    let output = mvs_eval(&arguments);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    (std::fs::read(&job.out).unwrap(), stderr(&output))
}

/// A run's `run.toml` says every option, also those that are only its mode's.
#[test]
fn a_mode_given_as_a_flag_is_the_whole_mode() {
    let scene = scene();
    let folder = tempfile::tempdir().unwrap();
    let job = write_scene(&scene, None, folder.path());
    cloud(&job, &["--min-sources", "2"]);
    let of_hkust = folder.path().join("hkust.toml");
    std::fs::rename(folder.path().join("cloud.run.toml"), &of_hkust).unwrap();
    let beside = ["--config", text(&of_hkust)];
    let (of_file, _) = cloud(&job, &beside);
    assert_eq!(of_file, cloud(&job, &["--min-sources", "2"]).0);
    let (geo, _) = cloud(&job, &[&beside[..], &["--mode", "geo"]].concat());
    let alone = ["--mode", "geo", "--min-sources", "2"];
    assert_eq!(geo, cloud(&job, &alone).0);
    assert_ne!(geo, of_file);
    let hkust = [&beside[..], &["--mode", "hkust"]].concat();
    assert_eq!(cloud(&job, &hkust).0, of_file);
}

/// The file counts; that it hides the preset is said.
#[test]
fn a_preset_beside_a_file_that_says_the_same_options_is_said_to_be_hidden() {
    let scene = scene();
    let folder = tempfile::tempdir().unwrap();
    let job = write_scene(&scene, None, folder.path());
    let (first, _) = cloud(&job, &[]);
    let run = folder.path().join("run.toml");
    std::fs::rename(folder.path().join("cloud.run.toml"), &run).unwrap();
    let both = ["--config", text(&run), "--preset", "tnt-intermediate"];
    let (found, said) = cloud(&job, &both);
    assert_eq!(found, first);
    assert!(
        said.contains("something else than the preset for min_sources: give"),
        "{said}"
    );
    let more = [&both[..], &["--min-sources", "3"]].concat();
    let said = cloud(&job, &more).1;
    assert!(!said.contains("something else than the preset"), "{said}");
}

/// Presets know scenes by the names that users give, whatever the folder behind a link is called.
#[cfg(unix)]
#[test]
fn a_preset_takes_the_name_of_the_link_that_is_given() {
    let scene = scene();
    let folder = tempfile::tempdir().unwrap();
    let mut job = write_scene(&scene, None, folder.path());
    let views = |job: &FuseJob| {
        let said = cloud(job, &["--preset", "tnt-intermediate"]).1;
        let views = said.split("min_sources = ").nth(1).unwrap().split(',');
        (
            views.into_iter().next().unwrap().to_owned(),
            said.contains("none for"),
        )
    };
    let real = job.scene.clone();
    assert_eq!(views(&job), ("5".into(), true));
    for (name, given) in [("Francis", "Francis"), ("Family", "Family/.")] {
        std::os::unix::fs::symlink(&real, folder.path().join(name)).unwrap();
        job.scene = folder.path().join(given);
        assert!(!views(&job).1, "{given}");
    }
    job.scene = folder.path().join("Francis");
    assert_eq!(views(&job), ("6".into(), false));
}

#[test]
fn depth_maps_without_a_cam_are_told_of() {
    let scene = scene();
    let folder = tempfile::tempdir().unwrap();
    let job = write_scene(&scene, None, folder.path());
    let (first, said) = cloud(&job, &[]);
    assert!(!said.contains("without a cam"), "{said}");
    let maps = Path::new(&job.depths);
    for name in ["00000123.pfm", "00000124.pfm", "00000003_prob.pfm"] {
        std::fs::copy(maps.join("00000003.pfm"), maps.join(name)).unwrap();
    }
    let (found, said) = cloud(&job, &[]);
    assert_eq!(found, first);
    assert!(
        said.contains(
            "2 depth maps are of views without a cam and are left out, the first is 00000123.pfm"
        ),
        "{said}"
    );
}

#[test]
fn a_replay_elsewhere_asks_where_filtered_depths_go() {
    let scene = scene();
    let folder = tempfile::tempdir().unwrap();
    let job = write_scene(&scene, None, folder.path());
    let path = |name: &str| folder.path().join(name);
    let (first, _) = cloud(&job, &["--filtered-depths", text(&path("filtered"))]);
    let run = path("cloud.run.toml");
    let replay = |more: &[&str]| mvs_eval(&[&["replay", text(&run)], more].concat());
    let elsewhere = ["--out", text(&path("again.ply"))].map(str::to_owned);
    let elsewhere: Vec<&str> = elsewhere.iter().map(String::as_str).collect();
    let refused = replay(&elsewhere);
    assert_eq!(refused.status.code(), Some(2));
    assert!(
        stderr(&refused).contains("--filtered-depths"),
        "{}",
        stderr(&refused)
    );
    let also = path("filtered again");
    let made = replay(&[&elsewhere[..], &["--filtered-depths", text(&also)]].concat());
    assert_eq!(made.status.code(), Some(0), "{}", stderr(&made));
    assert_eq!(std::fs::read(path("again.ply")).unwrap(), first);
    let maps = |folder: &Path| std::fs::read(folder.join("00000003.pfm")).unwrap();
    assert_eq!(maps(&also), maps(&path("filtered")));
}

/// What a file of one's own says beside its mode is meant, and how a number is written does not matter.
#[test]
fn a_file_that_is_no_run_is_taken_at_its_word() {
    let scene = scene();
    let folder = tempfile::tempdir().unwrap();
    let job = write_scene(&scene, None, folder.path());
    let file = folder.path().join("mine.toml");
    let of = |content: &str| {
        write(&file, content);
        cloud(&job, &["--config", text(&file), "--mode", "geo"]).0
    };
    // That of hkust, and not of geo.
    let said = of("[fuse]\nmode = \"hkust\"\nmin_sources = 2\nguard = true\n");
    assert_eq!(said, of("[fuse]\nmin_sources = 2\nguard = true\n"));
    assert_ne!(said, of("[fuse]\nmin_sources = 2\n"));
    let [whole, real] = ["2", "2.0"].map(|bound| {
        of(&format!(
            "[fuse]\nmode = \"cluster\"\nmax_pixel_error = {bound}\n"
        ))
    });
    assert_eq!(whole, real);
}

/// Only what a preset decides is said of it.
#[test]
fn a_preset_is_not_said_to_count_where_it_does_not() {
    let scene = scene();
    let folder = tempfile::tempdir().unwrap();
    let job = write_scene(&scene, None, folder.path());
    let unknown = |more: &[&str]| {
        let preset = ["--preset", "tnt-intermediate"];
        cloud(&job, &[&preset[..], more].concat())
            .1
            .contains("its general one is used")
    };
    assert!(unknown(&[]));
    assert!(!unknown(&["--min-sources", "2"]) && !unknown(&["--mode", "dynamic"]));
    cloud(&job, &[]);
    let run = folder.path().join("run.toml");
    std::fs::rename(folder.path().join("cloud.run.toml"), &run).unwrap();
    // Its least confidence is that of the run, which an f32 of it was.
    let both = ["--config", text(&run), "--preset", "blendedmvs"];
    let said = cloud(&job, &both).1;
    assert!(
        !said.contains("min_confidence: give") && !said.contains("for min_confidence"),
        "{said}"
    );
}

/// What another revision made may come out otherwise now.
#[test]
fn a_replay_says_that_another_revision_made_the_run() {
    let scene = scene();
    let folder = tempfile::tempdir().unwrap();
    let job = write_scene(&scene, None, folder.path());
    cloud(&job, &[]);
    let run = folder.path().join("cloud.run.toml");
    let replay = |name: &str| {
        let out = folder.path().join(name);
        let output = mvs_eval(&["replay", text(&run), "--out", text(&out)]);
        assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
        stderr(&output)
    };
    assert!(!replay("a.ply").contains("other-version"));
    let said = files::read_text(&run).unwrap();
    let revision = Run::read(&run).unwrap().revision;
    write(&run, said.replace(&revision, "0123456789ab"));
    let is_known = revision != "unknown";
    let warned = replay("b.ply").contains("[other-version]");
    assert_eq!(warned, is_known, "{revision}");
}
