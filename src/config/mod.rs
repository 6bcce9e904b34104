//! Options: defaults < preset < file < flags, each a layer that overrides the one before.

mod size;

pub use size::Size;

use crate::error::{Error, Result};
use crate::provenance::Run;
use mvs_datasets::layout::files;
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::path::Path;
use toml::{Table, Value};

/// Options from layers, the later ones overriding the earlier ones key by key. What no layer says
/// is the default; a key that the options do not have is an error.
///
/// # Errors
/// Names the key that the options do not have, or whose value they do not take.
pub fn resolve<T: DeserializeOwned>(layers: impl IntoIterator<Item = Table>) -> Result<T> {
    let mut merged = Table::new();
    for layer in layers {
        merge(&mut merged, layer);
    }
    merged.try_into().map_err(|error: toml::de::Error| {
        Error::invalid("options", error.to_string().trim().replace('\n', " "))
    })
}

/// The layer that says what `flags` says; absent options are left out.
///
/// # Errors
/// Flags that are no table, and values that TOML cannot hold, such as numbers of 2⁶³ and more.
pub fn layer_of(flags: &impl Serialize) -> Result<Table> {
    Table::try_from(flags).map_err(|error| Error::invalid("options", error.to_string()))
}

/// The layer in a file: the options `T` of a `run.toml` of the same command, or bare options.
///
/// # Errors
/// Names the file that cannot be read, is another command's, or has keys or values that `T` has not.
pub fn read_layer_of<T: DeserializeOwned>(path: &Path, command: &str) -> Result<Table> {
    let layer = read_layer(path, command)?;
    match layer.clone().try_into::<T>() {
        Ok(_) => Ok(layer),
        Err(error) => {
            let problem = error.to_string().trim().replace('\n', " ");
            Err(Error::invalid(path.display().to_string(), problem))
        }
    }
}

fn read_layer(path: &Path, command: &str) -> Result<Table> {
    let text = files::read_text(path)?;
    let table: Table = toml::from_str(&text)
        .map_err(|error| Error::toml(path.display().to_string(), &text, &error))?;
    if !table.contains_key("command") {
        return Ok(table);
    }
    let run = Run::read(path)?;
    if run.command != command {
        let problem = format!(
            "expected options of `{command}`, found a run of `{}`",
            run.command
        );
        return Err(Error::invalid(path.display().to_string(), problem));
    }
    Ok(run.options)
}

/// Whether the file at `path` is a `run.toml`, which says all options.
pub fn is_run(path: &Path) -> bool {
    Run::read(path).is_ok()
}

/// Two ways to say one thing, which do not go together or of which the second wins: where a layer says the first,
/// what lower layers say of the second does not count.
const INSTEAD: [(&str, &str); 5] = [
    ("d0", "sigma"),
    ("min_confidence", "confidence_quantile"),
    ("confidence_quantile", "min_confidence"),
    ("transform", "trajectory"),
    ("trajectory", "transform"),
];

/// Overrides `base` with `over`, table by table.
fn merge(base: &mut Table, over: Table) {
    for (name, instead) in INSTEAD {
        // A quantile of 0 is none.
        let is_zero =
            |value: &Value| value.as_float() == Some(0.0) || value.as_integer() == Some(0);
        let is_none = |value: &Value| name == "confidence_quantile" && is_zero(value);
        if over.get(name).is_some_and(|value| !is_none(value)) {
            base.remove(instead);
        }
    }
    for (key, value) in over {
        match (base.get_mut(&key), value) {
            (Some(Value::Table(below)), Value::Table(above)) => merge(below, above),
            (_, value) => {
                base.insert(key, value);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde::Deserialize;

    #[derive(Debug, PartialEq, Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    struct Inner {
        a: u32,
        b: u32,
    }

    impl Default for Inner {
        fn default() -> Self {
            Self { a: 1, b: 2 }
        }
    }

    #[derive(Debug, Default, PartialEq, Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    struct Outer {
        name: String,
        inner: Inner,
    }

    fn table(text: &str) -> Table {
        toml::from_str(text).unwrap()
    }

    #[test]
    fn later_layers_override_key_by_key() {
        let layers = [
            table("name = 'x'\ninner.a = 5\ninner.b = 6"),
            table("inner.b = 7"),
        ];
        let outer: Outer = resolve(layers).unwrap();
        assert_eq!(
            outer,
            Outer {
                name: "x".into(),
                inner: Inner { a: 5, b: 7 }
            }
        );
        assert_eq!(resolve::<Outer>([]).unwrap().inner, Inner { a: 1, b: 2 });
    }

    #[test]
    fn unknown_keys_are_named() {
        let error = resolve::<Outer>([table("inner.c = 1")])
            .unwrap_err()
            .to_string();
        assert!(error.contains("unknown field `c`"), "{error}");
    }

    #[test]
    fn two_ways_to_say_one_thing_do_not_meet() {
        let table = |text: &str| text.parse::<Table>().unwrap();
        let file = table("sigma = 1.0\n[options.blend]\nsigma = 3.0\nmode = \"composite\"\n");
        let after = |flags: &str| {
            let mut file = file.clone();
            merge(&mut file, table(flags));
            file
        };
        let beside = table("sigma = 1.0\n[options.blend]\nsigma = 3.0\nmode = \"reference\"\n");
        assert_eq!(after("options.blend.mode = \"reference\""), beside);
        let without = "sigma = 1.0\n[options.blend]\nmode = \"composite\"\nd0 = 100.0\n";
        assert_eq!(after("options.blend.d0 = 100.0"), table(without));
        assert_eq!(after("d0 = 100.0").get("sigma"), None);
        // A run.toml says both.
        let both = "d0 = 5000.0\nsigma = 2.0";
        assert_eq!(after(both)["sigma"], table(both)["sigma"]);
        for (one, other) in [
            ("min_confidence", "confidence_quantile"),
            ("transform", "trajectory"),
        ] {
            for (below, above) in [(one, other), (other, one)] {
                let [mut base, flags] = [below, above].map(|name| table(&format!("{name} = 0.5")));
                merge(&mut base, flags.clone());
                assert_eq!(base, flags);
                // A run.toml of fusion says both.
                let whole = table(&format!("{below} = 0.0\n{above} = 0.25"));
                merge(&mut base, whole.clone());
                assert_eq!(base, whole);
            }
        }
    }

    /// Without a quantile the threshold of layers below stands; a threshold of 0 is one.
    #[test]
    fn a_quantile_of_nothing_takes_no_threshold_away() {
        let after = |flags: &str| {
            let mut file = table("[fuse]\nmin_confidence = 0.5\nconfidence_quantile = 0.2\n");
            merge(&mut file, table(flags));
            file
        };
        for none in ["0.0", "0"] {
            let found = after(&format!("fuse.confidence_quantile = {none}"));
            assert_eq!(
                found["fuse"]["min_confidence"].as_float(),
                Some(0.5),
                "{none}"
            );
        }
        let found = after("fuse.confidence_quantile = 0.3");
        assert!(found["fuse"].get("min_confidence").is_none());
        let found = after("fuse.min_confidence = 0.0");
        assert!(found["fuse"].get("confidence_quantile").is_none());
    }
}
