//! Help, as it is read on terminals of two widths.

use assert_cmd::Command;

fn help(command: Option<&str>, columns: usize) -> String {
    let mut run = Command::new(assert_cmd::cargo::cargo_bin!("mvs-eval"));
    run.env("COLUMNS", columns.to_string()).args(command);
    let output = run.arg("--help").output().unwrap();
    assert!(output.status.success());
    String::from_utf8(output.stdout).unwrap()
}

#[test]
fn values_that_are_a_list_say_how_it_is_written() {
    for (command, flag) in [
        ("generate", "--extras"),
        ("score", "--tau"),
        ("render", "--also"),
    ] {
        let text = help(Some(command), 100);
        let said = text.split(&format!(" {flag} <")).nth(1).unwrap();
        let said: String = said.chars().take(250).collect();
        assert!(said.contains("separated by commas"), "{flag}: {said}");
    }
}
