use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use mvs_eval::progress::Progress;
use std::io::IsTerminal;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Set by the first Ctrl-C.
pub(crate) static INTERRUPTED: AtomicBool = AtomicBool::new(false);

/// Progress on stderr: a bar on a terminal, a line per stage and quarter otherwise.
pub(crate) struct Bars {
    state: Mutex<State>,
    mode: Mode,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Mode {
    Bar,
    Lines,
    Quiet,
}

struct State {
    bar: ProgressBar,
    stage: String,
    total: u64,
    done: u64,
    quarters: u64,
}

impl Bars {
    pub(crate) fn new(quiet: bool) -> Self {
        let mode = match (quiet, std::io::stderr().is_terminal()) {
            (true, _) => Mode::Quiet,
            (false, true) => Mode::Bar,
            (false, false) => Mode::Lines,
        };
        let bar = ProgressBar::hidden();
        let state = State {
            bar,
            stage: String::new(),
            total: 0,
            done: 0,
            quarters: 0,
        };
        Self {
            state: Mutex::new(state),
            mode,
        }
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Ends the last stage's bar.
    pub(crate) fn finish(&self) {
        self.state().bar.finish_and_clear();
    }
}

fn new_bar(stage: &str, total: u64) -> ProgressBar {
    let target = ProgressDrawTarget::stderr_with_hz(10);
    let bar = ProgressBar::with_draw_target(Some(total), target);
    let template = "{msg:24} {wide_bar} {pos}/{len} {elapsed_precise} (left {eta})";
    if let Ok(style) = ProgressStyle::with_template(template) {
        bar.set_style(style);
    }
    bar.set_message(stage.to_owned());
    bar
}

impl Progress for Bars {
    fn begin(&self, stage: &str, total: u64) {
        let mut state = self.state();
        state.bar.finish_and_clear();
        (state.stage, state.total) = (stage.to_owned(), total);
        (state.done, state.quarters) = (0, 0);
        match self.mode {
            Mode::Bar => state.bar = new_bar(stage, total),
            Mode::Lines => super::output::say(&format!("{stage}: {total} to do")),
            Mode::Quiet => {}
        }
    }

    fn advance(&self, steps: u64) {
        let mut state = self.state();
        state.done += steps;
        state.bar.inc(steps);
        let quarters = (4 * state.done).checked_div(state.total).unwrap_or(4);
        if self.mode == Mode::Lines && quarters > state.quarters && state.total >= 8 {
            state.quarters = quarters;
            super::output::say(&format!(
                "{}: {} of {}",
                state.stage, state.done, state.total
            ));
        }
    }

    fn cancelled(&self) -> bool {
        INTERRUPTED.load(Ordering::Relaxed)
    }
}
