//! Where answers go.

use super::*;

/// A disk that is full, as the system offers one: what failed is said, and that the result is there.
#[test]
fn an_answer_that_cannot_be_written_is_said_to_be_for_stdout() {
    let scene = small_scene();
    let path = |name: &str| scene.path().join(name);
    let (mesh, cams, out) = (path("mesh.obj"), path("cams"), path("out"));
    let full = || fs::File::options().write(true).open("/dev/full").unwrap();
    let run = |arguments: &[&str]| {
        let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_mvs-eval"));
        let output = command.args(arguments).stdout(full()).output().unwrap();
        assert_eq!(output.status.code(), Some(2), "{arguments:?}");
        stderr(&output)
    };
    for arguments in [
        &render_arguments(&mesh, &cams, &out)[..],
        &["inspect", text(&mesh)],
        &["--help"],
        &["fuse", "--help"],
        &["--version"],
    ] {
        let said = run(arguments);
        let line = said.lines().find(|line| line.starts_with("error: "));
        let line = line.unwrap_or_else(|| panic!("{arguments:?}: {said}"));
        assert!(line.starts_with("error: stdout: cannot write"), "{line}");
        assert!(line.contains("No space left"), "{line}");
    }
    assert!(out.join("run.toml").is_file());
}
