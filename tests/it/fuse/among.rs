//! Results that lie among their inputs: they count for none of them, and replace none.

use super::*;
use crate::support::{text, write};

/// A scene without the folder `cams`, whose own folder is an input then.
fn write_flat(folder: &Path) -> FuseJob {
    let job = write_scene(&scene(), None, folder);
    for entry in std::fs::read_dir(folder.join("cams")).unwrap() {
        let path = entry.unwrap().path();
        std::fs::rename(&path, folder.join(path.file_name().unwrap())).unwrap();
    }
    std::fs::remove_dir(folder.join("cams")).unwrap();
    job
}

fn changed(run_file: &Path) -> Vec<String> {
    Run::read(run_file).unwrap().changed_inputs(run_file)
}

#[test]
fn inputs_are_the_folders_of_a_scene_or_the_cams_beside_them() {
    let folder = tempfile::tempdir().unwrap();
    let job = write_flat(folder.path());
    fuse(&job, false).unwrap();
    let inputs = Run::read(&folder.path().join("cloud.run.toml"))
        .unwrap()
        .inputs;
    let named = |part: &str| inputs.keys().filter(|path| path.ends_with(part)).count();
    assert_eq!(
        (named("_cam.txt"), named("pair.txt"), named("images")),
        (12, 1, 1)
    );
}

/// A flat scene whose folder is an input and takes the results, again and again.
#[test]
fn results_that_lie_among_the_inputs_are_replaced_and_are_none_of_them() {
    let folder = tempfile::tempdir().unwrap();
    let mut job = write_flat(folder.path());
    std::fs::remove_dir_all(folder.path().join("images")).unwrap();
    let run_file = folder.path().join("cloud.run.toml");
    let whole = folder.path().display().to_string();
    let recorded = || Run::read(&run_file).unwrap().inputs[&whole].clone();
    let cams_and_maps = mvs_eval::provenance::hash_path(folder.path()).unwrap();
    job.vis = true;
    job.filtered_depths = Some(folder.path().join("filtered/maps"));
    for force in [false, true] {
        fuse(&job, force).unwrap();
        assert!(folder.path().join("cloud.ply.vis").exists());
        assert!(folder.path().join("filtered/maps/00000000.pfm").exists());
        assert_eq!(recorded(), cams_and_maps);
        assert_eq!(changed(&run_file), [""; 0]);
    }
    // What only the result before has stays (the maps) and is then as others' files, or goes (the list).
    (job.vis, job.filtered_depths) = (false, None);
    fuse(&job, true).unwrap();
    assert!(!folder.path().join("cloud.ply.vis").exists());
    assert_ne!(recorded(), cams_and_maps);
    assert_eq!(changed(&run_file), [""; 0]);
    // Others' files count, at the names of results that this one does not have too; what is half written
    // does not.
    for (name, counts) in [
        ("notes", true),
        ("filtered/maps/notes", true),
        ("cloud.ply.vis", true),
        (".mvs-eval-cloud.ply-Ab12cd.part", false),
    ] {
        write(&folder.path().join(name), "mine");
        assert_eq!(changed(&run_file).contains(&whole), counts, "{name}");
        std::fs::remove_file(folder.path().join(name)).unwrap();
        assert_eq!(changed(&run_file), [""; 0], "{name}");
    }
}

#[test]
fn another_result_among_the_inputs_counts_and_one_without_names_is_replaced() {
    let folder = tempfile::tempdir().unwrap();
    let mut job = write_flat(folder.path());
    std::fs::remove_dir_all(folder.path().join("images")).unwrap();
    let (run_file, second) = (
        folder.path().join("cloud.run.toml"),
        folder.path().join("second.run.toml"),
    );
    fuse(&job, false).unwrap();
    // The second knows the first, which does not know it.
    let first = job.out.clone();
    job.out = folder.path().join("second.ply");
    fuse(&job, false).unwrap();
    let whole = folder.path().display().to_string();
    assert_eq!(
        (changed(&run_file), changed(&second)),
        (vec![whole], vec![])
    );
    job.out = first;
    // Results as they were written before their files were listed can be read.
    let text = std::fs::read_to_string(&run_file).unwrap();
    let unlisted: Vec<&str> = text
        .lines()
        .filter(|line| !line.starts_with("files"))
        .collect();
    assert_eq!(unlisted.len() + 1, text.lines().count());
    write(&run_file, unlisted.join("\n"));
    assert!(Run::read(&run_file).unwrap().files.is_empty());
    fuse(&job, true).unwrap();
    assert_eq!(changed(&run_file), [""; 0]);
}

fn sweep_again(job: &SweepJob, force: bool) -> mvs_eval::Result<usize> {
    let context = Context {
        progress: &Silent,
        warnings: &Warnings::default(),
        force,
    };
    sweep_job::run(job, &context).map(|outcome| outcome.rows.len())
}

#[test]
fn a_sweep_among_its_inputs_is_none_of_them_and_replaces_none() {
    let folder = tempfile::tempdir().unwrap();
    let fuse_job = write_scene(&scene(), None, folder.path());
    fuse(&fuse_job, false).unwrap();
    let depths = fuse_job.depths.clone();
    let mut job = SweepJob {
        out: depths.join("sweep.csv"),
        truth: Some(fuse_job.out.clone()),
        tau: 0.1,
        fuse: fuse_job,
        ..SweepJob::default()
    };
    (job.pixel_errors, job.min_sources) = (vec![1.0], vec![2, 3]);
    for force in [false, true] {
        assert_eq!(sweep_again(&job, force).unwrap(), 2);
        assert_eq!(changed(&depths.join("sweep.run.toml")), [""; 0]);
    }
    let map = depths.join("00000003.pfm");
    let cam = folder.path().join("cams/00000003_cam.txt");
    let elsewhere = folder.path().join("true.ply");
    std::fs::copy(&job.fuse.out, &elsewhere).unwrap();
    job.truth = Some(elsewhere.clone());
    // The run.toml of another command does not make what lies beside it a sweep.
    let cloud = folder.path().join("cams/cloud.csv");
    write(&cloud, "mine");
    std::fs::copy(
        folder.path().join("cloud.run.toml"),
        folder.path().join("cams/cloud.run.toml"),
    )
    .unwrap();
    for input in [map, cam, elsewhere, cloud] {
        let before = std::fs::read(&input).unwrap();
        job.out.clone_from(&input);
        let said = sweep_again(&job, true).unwrap_err().to_string();
        assert!(said.contains("found an input"), "{said}");
        assert!(said.contains(text(&input.with_extension(""))), "{said}");
        assert_eq!(std::fs::read(&input).unwrap(), before);
    }
}

/// As after `pairs`, whose result and `run.toml` lie among the cams.
#[test]
fn a_cloud_does_not_replace_the_pairs_that_it_reads() {
    let folder = tempfile::tempdir().unwrap();
    let mut job = write_scene(&scene(), None, folder.path());
    fuse(&job, false).unwrap();
    let run_file = folder.path().join("cams/pair.run.toml");
    let run = Run::read(&folder.path().join("cloud.run.toml")).unwrap();
    let of_pairs = Run {
        command: "pairs".to_owned(),
        files: ["pair.txt".to_owned()].into(),
        ..run
    };
    of_pairs.write(&run_file).unwrap();
    job.out = folder.path().join("cams/pair.txt");
    let before = std::fs::read(&job.out).unwrap();
    let said = fuse(&job, true).unwrap_err().to_string();
    assert!(said.contains("found an input"), "{said}");
    assert_eq!(std::fs::read(&job.out).unwrap(), before);
    assert!(run_file.exists());
}

/// Named from another place, as by links and from where the run was started.
#[test]
fn results_among_the_inputs_are_known_by_any_path() {
    let scene = scene();
    let folder = tempfile::tempdir().unwrap();
    let mut job = write_scene(&scene, None, folder.path());
    let cams = folder.path().join("cams");
    job.out = job.depths.join("../depths/below/cloud.ply");
    job.filtered_depths = Some(cams.join("../cams"));
    fuse(&job, false).unwrap();
    let run_file = folder.path().join("depths/below/cloud.run.toml");
    let run = Run::read(&run_file).unwrap();
    assert_eq!(run.changed_inputs(&run_file), [""; 0]);
    assert_eq!(run.files.len(), 2 + 12, "{:?}", run.files);
    assert!(run.files.contains("cloud.ply"), "{:?}", run.files);
    let elsewhere = "../../cams/00000003.pfm";
    assert!(run.files.contains(elsewhere), "{:?}", run.files);
    std::fs::copy(&job.out, cams.join("cloud.ply")).unwrap();
    assert_eq!(run.changed_inputs(&run_file), [cams.display().to_string()]);
}
