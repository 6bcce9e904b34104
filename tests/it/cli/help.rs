//! Help, as it is read on terminals of two widths.

use assert_cmd::Command;

fn help(command: Option<&str>, columns: usize) -> String {
    let mut run = Command::new(assert_cmd::cargo::cargo_bin!("mvs-eval"));
    run.env("COLUMNS", columns.to_string()).args(command);
    let output = run.arg("--help").output().unwrap();
    assert!(output.status.success());
    String::from_utf8(output.stdout).unwrap()
}

/// All commands but `help`, as the program lists them.
fn commands() -> Vec<String> {
    let text = help(None, 100);
    let listed = text.split("\nCommands:\n").nth(1).unwrap();
    let listed = listed.lines().take_while(|line| !line.is_empty());
    let names = listed.filter(|line| indent(line) == 2);
    let names = names.filter_map(|line| line.split_whitespace().next());
    names
        .filter(|&name| name != "help")
        .map(str::to_owned)
        .collect()
}

fn indent(line: &str) -> usize {
    line.chars().take_while(|&letter| letter == ' ').count()
}

/// Lists, usages, options and the drawing of the data's way have lines of their own.
fn is_prose(line: &str) -> bool {
    let own = ["-", "[", "Usage:"]
        .iter()
        .any(|mark| line.trim().starts_with(mark));
    !own && !line.trim().is_empty() && !line.contains("-->") && indent(line) != 2
}

/// A line ends where the next word has no room: text that was broken by hand for another width has short
/// lines in between.
#[test]
fn paragraphs_are_broken_once_at_the_width_of_the_terminal() {
    let commands = commands();
    assert!(commands.len() > 10, "{commands:?}");
    for columns in [80, 100] {
        let mut lines = 0;
        for command in [None]
            .into_iter()
            .chain(commands.iter().map(|name| Some(name.as_str())))
        {
            let text = help(command, columns);
            for (line, next) in text.lines().zip(text.lines().skip(1)) {
                let width = line.chars().count();
                assert!(width <= columns, "{command:?} at {columns}: {line}");
                if indent(line) != indent(next) || !is_prose(line) || !is_prose(next) {
                    continue;
                }
                let word = next.split_whitespace().next().unwrap();
                assert!(
                    width + 1 + word.chars().count() > columns,
                    "{command:?} at {columns}: `{word}` had room behind: {line}"
                );
                lines += 1;
            }
        }
        assert!(lines > 100, "{lines}");
    }
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
