//! The language model stage, through its public interface, on the complete tiny checkpoints of
//! `fixtures/tiny_*`.

#![expect(clippy::unwrap_used, reason = "helpers of tests are tests")]

mod broken;
mod commands;
mod constraints;
mod conversation;
mod families;
mod gguf;
mod hostile;
mod hub;
mod layouts;
mod own_family;
mod token_ids;
mod unread;

use image::RgbImage;
use planagent_mllm::{
    Constraint, Deadline, LocalModel, MllmError, PromptPrefix, Request, Sampling,
};
use safetensors::{Dtype, SafeTensors, serialize_to_file, tensor::TensorView};
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use tempfile::TempDir;

/// A committed checkpoint.
fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("tests/fixtures")
        .join(name)
}

/// The committed LLaVA.
fn tiny() -> PathBuf {
    fixture("tiny_llava")
}

fn open() -> LocalModel {
    LocalModel::open("tiny", &tiny()).unwrap()
}

fn picture() -> RgbImage {
    image::open(tiny().join("image.png")).unwrap().into_rgb8()
}

/// The prompt prefix of the reference chat.
fn prefix() -> PromptPrefix {
    PromptPrefix {
        system: "Drive safely.".into(),
        image: Some(picture().into()),
    }
}

/// The first prompt of the reference chat.
const FIRST: &str = "Is there a crosswalk ahead?";
/// The second.
const SECOND: &str = "Which lane, left or right? Überholen \u{1f697}!";

fn request(constraint: Constraint, max_new_tokens: usize) -> Request {
    Request {
        constraint,
        max_new_tokens,
        sampling: Sampling::Greedy,
        deadline: Deadline::NONE,
        draft: None,
    }
}

fn free(max_new_tokens: usize) -> Request {
    request(Constraint::Free, max_new_tokens)
}

/// A copy of a checkpoint, to change.
struct Copy(TempDir);

/// Tensors by name: number format, shape, bytes.
type Tensors = BTreeMap<String, (Dtype, Vec<usize>, Vec<u8>)>;

impl Copy {
    fn new() -> Self {
        Self::from_fixture("tiny_llava")
    }

    fn from_fixture(name: &str) -> Self {
        Self::of_folder(&fixture(name))
    }

    /// The files of a folder. What they were read from may forbid writing; the copies do not.
    fn of_folder(from: &Path) -> Self {
        let folder = tempfile::tempdir().unwrap();
        for entry in std::fs::read_dir(from).unwrap() {
            let path = entry.unwrap().path();
            if path.is_file() {
                std::fs::write(
                    folder.path().join(path.file_name().unwrap()),
                    std::fs::read(&path).unwrap(),
                )
                .unwrap();
            }
        }
        Self(folder)
    }

    fn folder(&self) -> &Path {
        self.0.path()
    }

    fn path(&self, file: &str) -> PathBuf {
        self.0.path().join(file)
    }

    fn open(&self) -> Result<LocalModel, MllmError> {
        LocalModel::open("copy", self.0.path())
    }

    /// The error that opening it gives.
    fn error(&self) -> MllmError {
        self.open()
            .map(|_| ())
            .expect_err("a broken checkpoint opens")
    }

    fn edit(&self, file: &str, change: impl FnOnce(&mut Value)) {
        let text = std::fs::read_to_string(self.path(file)).unwrap();
        let mut value = serde_json::from_str(&text).unwrap();
        change(&mut value);
        std::fs::write(self.path(file), value.to_string()).unwrap();
    }

    fn tensors(&self) -> Tensors {
        let bytes = std::fs::read(self.path("model.safetensors")).unwrap();
        SafeTensors::deserialize(&bytes)
            .unwrap()
            .iter()
            .map(|(name, view)| {
                (
                    name.to_string(),
                    (view.dtype(), view.shape().to_vec(), view.data().to_vec()),
                )
            })
            .collect()
    }

    fn write_tensors(&self, file: &str, tensors: &Tensors) {
        let views: BTreeMap<&str, TensorView<'_>> = tensors
            .iter()
            .map(|(name, (dtype, shape, bytes))| {
                (
                    name.as_str(),
                    TensorView::new(*dtype, shape.clone(), bytes).unwrap(),
                )
            })
            .collect();
        serialize_to_file(views, None, &self.path(file)).unwrap();
    }

    fn edit_tensors(&self, change: impl FnOnce(&mut Tensors)) {
        let mut tensors = self.tensors();
        change(&mut tensors);
        self.write_tensors("model.safetensors", &tensors);
    }
}
