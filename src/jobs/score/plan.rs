//! What a score job asks for, checked before anything is read.

use super::ScoreJob;
use super::document::{InputHashes, Protocol};
use super::input;
use crate::error::{Error, Result};
use crate::parallel;
use crate::provenance::sha256;
use crate::score::tnt::Profile;
use mvs_datasets::layout::tnt::{TntFolder, known_tolerance};
use mvs_metrics::Tolerance;
use std::path::{Path, PathBuf};

/// A job whose options go together and whose folders hold what they should.
pub(super) struct Plan {
    /// The scene's name, prefix of the outputs.
    pub(super) scene: String,
    /// At least one tolerance; exactly one for Tanks and Temples.
    pub(super) tolerances: Vec<Tolerance>,
    /// Every file that is read.
    pub(super) inputs: Vec<PathBuf>,
    /// The truth: the scene folder, or the file.
    pub(super) truth: Truth,
    /// The file with the reconstruction's cameras.
    trajectory: Option<PathBuf>,
}

/// Where the truth comes from.
pub(super) enum Truth {
    /// A cloud of its own.
    File(PathBuf),
    /// A Tanks and Temples scene folder.
    Folder(TntFolder),
}

impl Plan {
    /// Checks the options of `job` and finds its files.
    pub(super) fn new(job: &ScoreJob) -> Result<Self> {
        check_options(job)?;
        match job.protocol {
            Protocol::Plain => Self::plain(job),
            Protocol::Tnt => Self::tnt(job),
        }
    }

    fn plain(job: &ScoreJob) -> Result<Self> {
        let truth = job.truth.clone().unwrap_or_default();
        let tolerances = job.tau.iter().map(|&tau| Ok(Tolerance::new(tau)?));
        Ok(Self {
            scene: job.name.clone().unwrap_or_else(|| stem_of(&truth)),
            tolerances: tolerances.collect::<Result<_>>()?,
            inputs: inputs([Some(&truth), job.crop.as_ref()], None, job),
            trajectory: None,
            truth: Truth::File(truth),
        })
    }

    fn tnt(job: &ScoreJob) -> Result<Self> {
        let folder = job.scene.as_deref().unwrap_or(Path::new("."));
        let folder = TntFolder::open(folder, job.name.as_deref())?;
        let mut of_scene = vec![Some(&folder.truth), Some(&folder.crop)];
        if job.trajectory.is_some() {
            let mapping = folder.mapping.as_ref();
            of_scene.extend([Some(&folder.trajectory), Some(&folder.transform), mapping]);
        }
        let trajectory = input::trajectory_file(job)?;
        Ok(Self {
            scene: folder.name.clone(),
            tolerances: vec![tnt_tolerance(job, &folder.name)?],
            inputs: inputs(of_scene, trajectory.as_ref(), job),
            trajectory,
            truth: Truth::Folder(folder),
        })
    }
}

impl Plan {
    /// SHA-256 of every file that a record names.
    pub(super) fn hashes(&self, job: &ScoreJob) -> Result<InputHashes> {
        let (truth, crop, transform) = match &self.truth {
            Truth::File(truth) => (truth, job.crop.as_ref(), None),
            Truth::Folder(folder) => (&folder.truth, Some(&folder.crop), Some(&folder.transform)),
        };
        let transform = match &job.transform {
            Some(given) => Some(given),
            None => transform.filter(|_| job.trajectory.is_some()),
        };
        let trajectory = self.trajectory.as_ref();
        let files = [
            Some(&job.reconstruction),
            Some(truth),
            crop,
            trajectory,
            transform,
        ];
        let mut hashes = parallel::try_map(files.len(), |nth| {
            files[nth].map(|path| sha256(path)).transpose()
        })?
        .into_iter();
        let mut next = || hashes.next().flatten();
        Ok(InputHashes {
            reconstruction: next(),
            truth: next(),
            crop: next(),
            log: next(),
            transform: next(),
        })
    }
}

/// Resamples of which one lies beyond either end of a 95 % interval.
const MIN_RESAMPLES: u32 = 40;

/// Says which options are missing or do not go together.
fn check_options(job: &ScoreJob) -> Result<()> {
    if let Some(name) = &job.name {
        check_name(name)?;
    }
    check_values(job)?;
    if job.methods.is_some() {
        return Err(Error::invalid(
            "--methods",
            "belongs to --all, which is not given",
        ));
    }
    if job.protocol == Protocol::Tnt {
        return check_paths(job);
    }
    check_plain(job)
}

/// Says which values no scene can be scored with.
pub(in crate::jobs) fn check_values(job: &ScoreJob) -> Result<()> {
    if job.bootstrap > 0 && job.bootstrap < MIN_RESAMPLES {
        let problem = format!(
            "expected at least {MIN_RESAMPLES} resamples, of which the interval's ends are quantiles, \
             found {}",
            job.bootstrap
        );
        return Err(Error::invalid("--bootstrap", problem));
    }
    let is_twice = |(place, tau): (usize, &f64)| job.tau[..place].contains(tau);
    if let Some(place) = (job.tau.iter().enumerate()).position(is_twice) {
        let problem = format!(
            "expected distinct distances, found {:?} again at place {place}",
            job.tau[place]
        );
        return Err(Error::invalid("--tau", problem));
    }
    for &tau in &job.tau {
        Tolerance::new(tau)?;
    }
    if job.protocol == Protocol::Tnt && job.tau.len() > 1 {
        let problem = format!(
            "expected one τ, found {}: the protocol's voxels and ICP stages depend on it",
            job.tau.len()
        );
        return Err(Error::invalid("--tau", problem));
    }
    let distance = job.camera_distance;
    if !(distance.is_finite() && distance > 0.0) {
        let problem = format!("expected a distance above 0, found {distance}");
        return Err(Error::invalid("--camera-distance", problem));
    }
    Ok(())
}

/// Says which options the plain protocol has none of.
fn check_plain(job: &ScoreJob) -> Result<()> {
    let frame = "the plain protocol takes clouds that share a frame";
    let aligned = "the plain protocol aligns nothing";
    let [seeds, camera_distance] = alignment_options(job);
    let foreign = [
        (
            job.scene.is_some(),
            "--scene",
            "the plain protocol takes --truth",
        ),
        (job.trajectory.is_some(), "--trajectory", frame),
        (job.refine, "--refine", aligned),
        (job.profile != Profile::default(), "--profile", aligned),
        (seeds, "--seeds", aligned),
        (job.one_profile, "--one-profile", aligned),
        (camera_distance, "--camera-distance", aligned),
    ];
    match foreign.into_iter().find(|(given, _, _)| *given) {
        Some((_, option, why)) => {
            let problem = format!("belongs to --protocol tnt; {why}");
            Err(Error::invalid(option, problem))
        }
        None => check_paths(job),
    }
}

/// A name begins the names of the outputs, which lie in the output folder.
fn check_name(name: &str) -> Result<()> {
    if name.is_empty() || name.contains(['/', '\\']) || name.starts_with("..") {
        let problem = format!("expected a name without / and \\, found `{name}`");
        return Err(Error::invalid("--name", problem));
    }
    Ok(())
}

fn check_paths(job: &ScoreJob) -> Result<()> {
    let needed = |given: bool, option: &str| {
        let problem = format!("needed by --protocol {}, not given", job.protocol);
        if given {
            Ok(())
        } else {
            Err(Error::invalid(option, problem))
        }
    };
    needed(
        !job.reconstruction.as_os_str().is_empty(),
        "--reconstruction",
    )?;
    needed(!job.out.as_os_str().is_empty(), "--out")?;
    if job.protocol == Protocol::Plain {
        needed(job.truth.is_some(), "--truth")?;
        return needed(!job.tau.is_empty(), "--tau");
    }
    needed(job.scene.is_some(), "--scene")?;
    if job.transform.is_some() == job.trajectory.is_some() {
        let problem = "expected exactly one of them: the reconstruction's cameras, or a known \
                       transform into the frame of the truth";
        return Err(Error::invalid("--transform, --trajectory", problem));
    }
    if job.refine && job.transform.is_none() {
        let problem = "belongs to --transform; an alignment by cameras is always refined";
        return Err(Error::invalid("--refine", problem));
    }
    let plain =
        "belongs to the plain protocol; --protocol tnt takes it from the scene folder and τ";
    let aligned = "belongs to --trajectory or --refine: a --transform alone is taken as it is";
    let fixed = job.transform.is_some() && !job.refine;
    let [seeds, camera_distance] = alignment_options(job);
    let foreign = [
        (job.truth.is_some(), "--truth", plain),
        (job.crop.is_some(), "--crop", plain),
        (job.voxel.is_some(), "--voxel", plain),
        (fixed && seeds, "--seeds", aligned),
        (
            job.transform.is_some() && camera_distance,
            "--camera-distance",
            "belongs to --trajectory: a --transform comes without cameras",
        ),
    ];
    match foreign.into_iter().find(|(given, _, _)| *given) {
        Some((_, option, why)) => Err(Error::invalid(option, why)),
        None => Ok(()),
    }
}

/// Whether seeds, and a distance of cameras, are asked for: only an alignment heeds them.
fn alignment_options(job: &ScoreJob) -> [bool; 2] {
    let standard = ScoreJob::default();
    [
        job.seeds != standard.seeds,
        job.camera_distance.to_bits() != standard.camera_distance.to_bits(),
    ]
}

/// The files given, the reconstruction and how it is aligned.
fn inputs<'a>(
    paths: impl IntoIterator<Item = Option<&'a PathBuf>>,
    trajectory: Option<&'a PathBuf>,
    job: &'a ScoreJob,
) -> Vec<PathBuf> {
    let of_job = [
        Some(&job.reconstruction),
        job.transform.as_ref(),
        trajectory,
    ];
    paths.into_iter().chain(of_job).flatten().cloned().collect()
}

/// The τ asked for, or that of a known scene.
fn tnt_tolerance(job: &ScoreJob, scene: &str) -> Result<Tolerance> {
    let tau = job.tau.first().copied();
    match tau.or_else(|| known_tolerance(scene)) {
        Some(tau) => Ok(Tolerance::new(tau)?),
        None => {
            let problem = format!("`{scene}` is not one of the seven known scenes: give its τ");
            Err(Error::invalid("--tau", problem))
        }
    }
}

/// A file's name without its last extension.
pub(super) fn stem_of(path: &Path) -> String {
    path.file_stem()
        .unwrap_or_default()
        .to_string_lossy()
        .into_owned()
}
