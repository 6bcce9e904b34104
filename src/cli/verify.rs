use super::common::{Centre, Global, Verdict, resolve, with_context};
use super::output::{answer, table};
use clap::Args;
use mvs_eval::jobs::verify::{self, VerifyJob};
use serde::Serialize;
use std::path::PathBuf;

/// Check a BlendedMVS scene: format, depth against cameras, colours, conventions
///
/// Names what is wrong (half a pixel, swapped poses, scaled intrinsics, range instead of z-depth,
/// shuffled pairs, a single view that does not fit, images moved against depths, missing files, bytes other
/// than scene.json says were made, …), says how well the views agree, and exits with 1 when there is a fault.
/// Works on anybody's data in that format.
#[derive(Debug, Args, Serialize)]
pub(crate) struct VerifyArgs {
    /// A scene folder, or a data set's root, whose scenes are all verified, listed ones too
    scene: Option<PathBuf>,
    /// A folder for verify.json
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    #[command(flatten)]
    verify: VerifyFlags,
}

#[derive(Debug, Args, Serialize)]
struct VerifyFlags {
    /// The pixel centre of the intrinsics; by default what scene.json says, else half
    #[arg(long = "pixel-center", value_enum, value_name = "PIXEL_CENTER")]
    #[serde(skip_serializing_if = "Option::is_none")]
    pixel_centre: Option<Centre>,
    /// Points per view that are carried into its source views (default 2000, at least 200)
    #[arg(long, value_name = "N")]
    #[serde(skip_serializing_if = "Option::is_none")]
    points: Option<u32>,
}

pub(crate) fn run(args: &VerifyArgs, global: &Global) -> anyhow::Result<Verdict> {
    execute(&resolve("verify", args, global)?, global)
}

pub(crate) fn execute(job: &VerifyJob, global: &Global) -> anyhow::Result<Verdict> {
    let outcome = with_context(global, |context| verify::run(job, context))?;
    answer(global.format, &outcome, || {
        let mut table = table(&["scene", "code", "place", "finding"]);
        for (scene, verification) in &outcome.scenes {
            for finding in &verification.findings {
                table.add_row([scene, &finding.code, &finding.place, &finding.message]);
            }
            let nothing = verification.findings.is_empty();
            let nothing = nothing.then(|| "nothing wrong was found".to_owned());
            let said: Vec<String> = nothing
                .into_iter()
                .chain(verification.agreement())
                .collect();
            if !said.is_empty() {
                table.add_row([scene, "–", "", &said.join("; ")]);
            }
        }
        table
    })?;
    Ok(Verdict::failed_if(outcome.failed()))
}
