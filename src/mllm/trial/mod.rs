//! Tries the small files of a model in a child process before this one opens them.
//!
//! A chat template and a tokenizer are small programs, and a downloaded model folder is hostile
//! until shown otherwise. Templates have limits in this process (`text::template_bounds`), but none
//! on the memory of their values, and the library that runs tokenizers has none at all. So a child
//! process with limits of memory and time opens them first and reads sample texts. It does so once
//! for each content of the files.

mod child;
mod exercise;
mod request;
mod verdicts;

pub use child::limit_this_process;
pub use exercise::exercise;
pub use request::TrialRequest;
pub(crate) use request::{hash_file, small_files};

use super::{Loading, MllmError, ModelPlace};
use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use verdicts::Verdicts;

/// Why the chat template and the tokenizer of a model may be opened in this process.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub enum Trust {
    /// They may not: only models in the program, servers, and models whose description says
    /// `trusted = true` are opened.
    #[default]
    Nobody,
    /// The caller vouches for them. Nothing limits their memory and time but what this process may
    /// use.
    Caller,
    /// A child process opened them first, within limits.
    Trial(Trial),
}

/// How a child process is started that tries the files of a model.
#[derive(Clone, PartialEq, Eq)]
pub struct Trial {
    /// The program and its arguments. It reads a [`TrialRequest`] and calls [`limit_this_process`]
    /// and [`exercise`].
    program: PathBuf,
    arguments: Vec<String>,
    /// Texts that the tokenizer reads besides its own.
    samples: Arc<[String]>,
    /// Folder of the verdicts; none where none can be kept.
    verdicts: Option<PathBuf>,
}

impl fmt::Debug for Trial {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.debug_struct("Trial")
            .field("program", &self.program)
            .finish_non_exhaustive()
    }
}

impl Trial {
    /// A trial by a program. Its verdicts are kept in the cache folder of this program.
    pub fn by(
        program: impl Into<PathBuf>,
        arguments: &[&str],
        samples: impl IntoIterator<Item = String>,
    ) -> Self {
        Self {
            program: program.into(),
            arguments: arguments.iter().map(ToString::to_string).collect(),
            samples: samples.into_iter().collect(),
            verdicts: planagent_files::cache_folder().map(|folder| folder.join("models")),
        }
    }

    /// Tries the files of a model, unless they passed before.
    fn admit(&self, place: &Path, request: &TrialRequest) -> Result<(), MllmError> {
        let verdicts = self.verdicts.as_deref().map(Verdicts::new);
        let digest = request.digest()?;
        if verdicts
            .as_ref()
            .is_some_and(|verdicts| verdicts.passed(&digest))
        {
            return Ok(());
        }
        let outcome = child::run(&self.program, &self.arguments, request);
        let problem = outcome.map_err(|problem| MllmError::Trial {
            place: place.to_path_buf(),
            problem,
        })?;
        if let Some(problem) = problem {
            return Err(MllmError::Unopened { problem });
        }
        if let Some(verdicts) = verdicts {
            verdicts.keep(&digest);
        }
        Ok(())
    }
}

impl Trust {
    /// Whether the small files of a model may be opened in this process.
    ///
    /// # Errors
    /// When nobody vouches for them, or they went beyond the limits of the child process that tried
    /// them.
    pub(crate) fn admit(&self, place: &ModelPlace, loading: &Loading) -> Result<(), MllmError> {
        let Some(request) = TrialRequest::for_model(place, loading) else {
            return Ok(());
        };
        match self {
            Self::Caller => Ok(()),
            Self::Nobody => Err(MllmError::Untrusted {
                place: place.path().to_path_buf(),
            }),
            Self::Trial(trial) => trial.admit(place.path(), &request.with_samples(&trial.samples)),
        }
    }
}
