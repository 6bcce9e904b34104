//! Named parameter sets, as layers of options.

use super::options::{FuseMode, FuseOptions};
use crate::error::{Error, Result};
use serde::Deserialize;
use std::collections::BTreeMap;
use toml::{Table, Value};

/// The file that says it all.
const FILE: &str = include_str!("presets.toml");

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Presets {
    mode: BTreeMap<String, Table>,
    preset: BTreeMap<String, Table>,
}

fn presets() -> Result<Presets> {
    toml::from_str(FILE).map_err(|error| Error::invalid("presets", error.to_string()))
}

/// The names of the presets.
pub fn names() -> Vec<String> {
    presets().map_or_else(|_| Vec::new(), |all| all.preset.into_keys().collect())
}

/// What a mode sets, by its name.
///
/// # Errors
/// Names the modes when there is none of this name.
pub fn mode_layer(name: &str) -> Result<Table> {
    pick(presets()?.mode, "mode", name)
}

/// What a preset sets. Presets with a minimum of views per scene use that of `scene`, the general
/// one for scenes that they do not know.
///
/// # Errors
/// Names the presets when there is none of this name.
pub fn preset_layer(name: &str, scene: &str) -> Result<Table> {
    let mut layer = pick(presets()?.preset, "preset", name)?;
    let scenes = layer.remove("scenes");
    let known = scenes.and_then(|scenes| scenes.get(scene).and_then(Value::as_integer));
    if let Some(views) = known {
        layer.insert("min_sources".into(), Value::Integer(views));
    }
    Ok(layer)
}

/// The scenes that a preset has a minimum of views of their own for.
///
/// # Errors
/// Names the presets when there is none of this name.
pub fn scenes(name: &str) -> Result<Vec<String>> {
    let layer = pick(presets()?.preset, "preset", name)?;
    let scenes = layer.get("scenes").and_then(Value::as_table);
    Ok(scenes.map_or_else(Vec::new, |scenes| scenes.keys().cloned().collect()))
}

fn pick(mut all: BTreeMap<String, Table>, what: &str, name: &str) -> Result<Table> {
    let names: Vec<String> = all.keys().cloned().collect();
    all.remove(name).ok_or_else(|| {
        let problem = format!("expected one of {}, found `{name}`", names.join(", "));
        Error::invalid(what, problem)
    })
}

impl FuseOptions {
    /// The options of a mode before anything else is said.
    pub fn of(mode: FuseMode) -> Self {
        let layer = Value::try_from(mode)
            .ok()
            .and_then(|name| name.as_str().map(str::to_owned))
            .and_then(|name| mode_layer(&name).ok());
        let options = layer.and_then(|layer| layer.try_into().ok());
        options.unwrap_or_default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_mode_and_preset_is_a_layer_of_options() {
        for mode in ["hkust", "geo", "dynamic", "gipuma", "cluster"] {
            let options: FuseOptions = mode_layer(mode).unwrap().try_into().unwrap();
            options.check().unwrap();
            assert_eq!(Value::try_from(options.mode).unwrap().as_str(), Some(mode));
            assert_eq!(FuseOptions::of(options.mode), options);
        }
        assert_eq!(names().len(), 5);
        for name in names() {
            let options: FuseOptions = preset_layer(&name, "").unwrap().try_into().unwrap();
            options.check().unwrap();
        }
    }

    #[test]
    fn known_scenes_bring_their_minimum_of_views() {
        let views =
            |scene| preset_layer("tnt-intermediate", scene).unwrap()["min_sources"].as_integer();
        assert_eq!((views("Francis"), views("Elsewhere")), (Some(6), Some(5)));
        assert!(
            scenes("tnt-intermediate")
                .unwrap()
                .contains(&"Francis".to_owned())
        );
        assert!(scenes("dtu").unwrap().is_empty());
        let error = preset_layer("nerf", "").unwrap_err().to_string();
        assert!(error.contains("dtu") && error.contains("`nerf`"), "{error}");
    }
}
