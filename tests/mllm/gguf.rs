//! Models as GGUF files, through what users have: the registry, folders, files.

use super::{Copy, FIRST, fixture, free, prefix};
use planagent_mllm::{
    GgufPart, HubAccess, LoadReport, MemoryCheck, Mllm, MllmError, ModelRegistry, ModelSource,
    Trust, WeightFormat,
};
use std::fs::{self, File};
use std::io::Write;
use std::path::{Path, PathBuf};

fn registry() -> ModelRegistry {
    ModelRegistry::new(
        "models",
        HubAccess {
            offline: true,
            ..HubAccess::default()
        },
    )
    .with_trust(Trust::Caller)
}

/// Writes a fixture as `m.gguf` and its vision tower beside it.
fn export(name: &str, folder: &Path, weight_format: WeightFormat) -> PathBuf {
    let model = folder.join("m.gguf");
    let spec = registry().find(fixture(name).to_str().unwrap()).unwrap();
    let mut create = |part: GgufPart| -> std::io::Result<Box<dyn Write>> {
        Ok(Box::new(File::create(part.path(&model))?))
    };
    registry()
        .export(&spec, weight_format, &mut create, &mut |_, _| {})
        .unwrap();
    model
}

fn open(place: &Path) -> Result<Box<dyn Mllm>, MllmError> {
    registry().open(&registry().find(place.to_str().unwrap())?)
}

fn answer(model: &dyn Mllm) -> String {
    model
        .converse(&prefix(), 0)
        .unwrap()
        .ask(FIRST, &free(12))
        .unwrap()
        .text
}

/// Changes bytes of a file.
fn edit(path: &Path, change: impl FnOnce(&mut Vec<u8>)) {
    let mut bytes = fs::read(path).unwrap();
    change(&mut bytes);
    fs::write(path, bytes).unwrap();
}

/// Replaces a text of a file by another of the same length.
fn replace(path: &Path, from: &str, to: &str) {
    assert_eq!(from.len(), to.len());
    edit(path, |bytes| {
        let at = bytes
            .windows(from.len())
            .position(|window| window == from.as_bytes())
            .unwrap();
        bytes[at..at + from.len()].copy_from_slice(to.as_bytes());
    });
}

#[test]
fn a_file_a_folder_and_a_description_open_the_same_model() {
    let folder = tempfile::tempdir().unwrap();
    let file = export("tiny_llava", folder.path(), WeightFormat::F32);
    let expected = answer(&super::open());
    let spec = registry().find(file.to_str().unwrap()).unwrap();
    assert_eq!(
        spec.source,
        ModelSource::File {
            file: file.clone(),
            mmproj: None
        }
    );
    let described = folder.path().join("tiny.toml");
    let text = "name = 'tiny'\narchitecture = 'llava'\nsource = { file = 'm.gguf', mmproj = 'mmproj-m.gguf' }\nprompt_set = 'paper'\n";
    fs::write(&described, text).unwrap();
    for place in [file.as_path(), folder.path(), &described] {
        assert_eq!(
            answer(&*open(place).unwrap()),
            expected,
            "{}",
            place.display()
        );
    }
    fs::write(&described, text.replace("'llava'", "'cogvlm'")).unwrap();
    let refused = open(&described).map(|_| ()).unwrap_err().to_string();
    assert!(refused.contains("this is a llava model"), "{refused}");
}

#[test]
fn the_description_says_how_weights_are_held() {
    let folder = fixture("tiny_llava");
    let about = open(&folder).unwrap().describe();
    assert_eq!(about.load.weight_formats.len(), 1);
    assert_eq!(
        about.load.weight_formats[0].weight_format,
        WeightFormat::F32
    );

    let registry = registry().with_quantize(Some(WeightFormat::Q4K));
    let quantised = registry
        .open(&registry.find(folder.to_str().unwrap()).unwrap())
        .unwrap()
        .describe();
    let LoadReport {
        quantize,
        weight_formats,
        exceptions,
        ..
    } = &quantised.load;
    assert_eq!(*quantize, Some(WeightFormat::Q4K));
    // Rows of 32 numbers are no whole blocks of 256, rows of 48 none of 32. The tower gets 8 bits.
    for held in [WeightFormat::Q5_0, WeightFormat::Q8_0, WeightFormat::F16] {
        let mut formats = weight_formats.iter().map(|share| share.weight_format);
        assert!(formats.any(|format| format == held), "{held}");
    }
    let fc2 = exceptions
        .iter()
        .find(|known| known.name.ends_with("mlp.fc2.weight"))
        .unwrap();
    assert_eq!((fc2.tensors, fc2.weight_format), (3, WeightFormat::F16));
    assert_eq!(quantised.parameters, about.parameters);
    // The record of a run takes it.
    assert!(toml::Table::try_from(&quantised).is_ok());
}

#[test]
fn truncated_and_hostile_files_are_errors() {
    for name in ["m.gguf", "mmproj-m.gguf"] {
        let folder = tempfile::tempdir().unwrap();
        export("tiny_llava", folder.path(), WeightFormat::Q8_0);
        let path = folder.path().join(name);
        let whole = fs::read(&path).unwrap();
        for length in [0, 3, 4, 12, 24, 100, 5000, whole.len() - 32] {
            fs::write(&path, &whole[..length]).unwrap();
            match open(folder.path()).map(|_| ()) {
                Err(MllmError::Gguf {
                    path: named,
                    problem,
                }) => {
                    assert_eq!(named, path);
                    let said = ["truncated", "left for them", "cannot lie"];
                    assert!(
                        said.iter().any(|said| problem.contains(said)),
                        "{length}: {problem}"
                    );
                }
                other => panic!("{length}: {other:?}"),
            }
        }
        // As many tensors and as much metadata as there are numbers.
        for at in [8, 16] {
            let mut absurd = whole.clone();
            absurd[at..at + 8].fill(0xff);
            fs::write(&path, absurd).unwrap();
            let error = open(folder.path()).map(|_| ()).unwrap_err();
            assert!(error.to_string().contains("are announced"), "{error}");
        }
    }
}

#[test]
fn what_is_missing_is_named_with_what_to_do() {
    let folder = tempfile::tempdir().unwrap();
    let model = export("tiny_llava", folder.path(), WeightFormat::F32);
    let tower = folder.path().join("mmproj-m.gguf");
    let error = |place: &Path| open(place).map(|_| ()).unwrap_err().to_string();

    assert!(
        error(&tower).contains("name the file of the decoder"),
        "{}",
        error(&tower)
    );
    let second = folder.path().join("other.gguf");
    fs::copy(&model, &second).unwrap();
    assert!(
        error(folder.path()).contains("several models (m.gguf, other.gguf)"),
        "{}",
        error(folder.path())
    );
    fs::remove_file(&second).unwrap();

    let moved = folder.path().join("tower.bin");
    fs::rename(&tower, &moved).unwrap();
    assert!(error(&model).contains("mmproj"), "{}", error(&model));
    // Of several towers without the decoder's name, none is chosen.
    for name in ["one.gguf", "two.gguf"] {
        fs::copy(&moved, folder.path().join(name)).unwrap();
    }
    assert!(
        error(&model).contains("several vision towers (one.gguf, two.gguf)"),
        "{}",
        error(&model)
    );
    // Of towers that differ in their weight format alone, llama.cpp's first is chosen.
    let [one, half, single] =
        ["one.gguf", "mmproj-F16.gguf", "mmproj-F32.gguf"].map(|name| folder.path().join(name));
    fs::rename(&one, &half).unwrap();
    fs::rename(folder.path().join("two.gguf"), &single).unwrap();
    assert!(open(&model).is_ok());
    fs::rename(&half, &one).unwrap();
    fs::remove_file(&single).unwrap();
    let alone = folder.path().join("tower_alone");
    fs::create_dir(&alone).unwrap();
    fs::copy(&moved, alone.join("mmproj-F16.gguf")).unwrap();
    assert!(
        error(&alone).contains("no decoder, only a vision tower (mmproj-F16.gguf)"),
        "{}",
        error(&alone)
    );
    // What is no model beside a single one does not matter.
    let [two, notes] = ["two.gguf", "notes.gguf"].map(|name| folder.path().join(name));
    fs::write(&notes, "no model").unwrap();
    assert!(open(&model).is_ok());
    fs::remove_file(&notes).unwrap();
    fs::copy(&moved, &two).unwrap();
    fs::rename(&moved, &tower).unwrap();
    fs::write(folder.path().join("partial.gguf"), "GGUF").unwrap();
    assert!(
        open(&model).is_ok(),
        "the one that is named after it, whatever else lies there"
    );

    replace(&tower, "blk.0.ln1.bias", "blk.9.ln1.bias");
    assert!(
        error(&model).contains("vision_tower.encoder.layers.0.layer_norm1.bias is missing"),
        "{}",
        error(&model)
    );
    replace(&model, "llama", "gemma");
    assert!(
        error(&model).contains("'gemma' is not supported"),
        "{}",
        error(&model)
    );
}

#[test]
fn a_file_of_another_writer_needs_a_tokenizer_that_fits() {
    let folder = tempfile::tempdir().unwrap();
    let model = export("tiny_llava", folder.path(), WeightFormat::F32);
    let error = || open(&model).map(|_| ()).unwrap_err();
    // Without the packed files of this program.
    for file in [
        "config",
        "tokenizer",
        "tokenizer_config",
        "generation_config",
        "preprocessor_config",
    ] {
        replace(
            &model,
            &format!("planagent.file.{file}.json"),
            &format!("someagent.file.{file}.json"),
        );
    }
    replace(
        &model,
        "planagent.file.chat_template.jinja",
        "someagent.file.chat_template.jinja",
    );
    replace(&model, "tokenizer.chat_template", "tokenizer.some_template");
    assert!(open(&model).is_ok(), "the tokenizer is in ggml's keys too");
    // What is missing has the name that the file would have for it.
    replace(&model, "output_norm.weight", "output_form.weight");
    let missing = "m.gguf: tensor output_norm.weight is missing";
    assert!(error().to_string().contains(missing), "{}", error());
    replace(&model, "output_form.weight", "output_norm.weight");
    replace(&model, "tokenizer.ggml.model", "tokenizer.some.model");
    assert!(
        error()
            .to_string()
            .contains("put the model's tokenizer.json beside it"),
        "{}",
        error()
    );

    let from = Copy::new();
    for file in [
        "tokenizer.json",
        "tokenizer_config.json",
        "chat_template.jinja",
    ] {
        fs::copy(from.path(file), folder.path().join(file)).unwrap();
    }
    let opened = open(&model).unwrap();
    assert_eq!(answer(&*opened), answer(&super::open()));
    // Without a template beside it, it gets Vicuna's, and the report says so.
    fs::remove_file(folder.path().join("chat_template.jinja")).unwrap();
    let notes = open(&model).unwrap().describe().load.notes;
    assert!(
        notes.iter().any(|note| note.contains("Vicuna")),
        "{notes:?}"
    );

    from.edit("tokenizer.json", |tokenizer| {
        tokenizer["model"]["vocab"]["far"] = serde_json::json!(9999);
    });
    fs::copy(
        from.path("tokenizer.json"),
        folder.path().join("tokenizer.json"),
    )
    .unwrap();
    assert!(
        matches!(
            error(),
            MllmError::Vocabulary {
                id: 9999,
                vocabulary: 352,
                ..
            }
        ),
        "{}",
        error()
    );
    fs::write(folder.path().join("tokenizer.json"), "{}").unwrap();
    assert!(
        matches!(error(), MllmError::Tokenizer { .. }),
        "{}",
        error()
    );
}

#[test]
fn scales_that_are_no_numbers_are_found() {
    let folder = tempfile::tempdir().unwrap();
    let model = export("tiny_llava", folder.path(), WeightFormat::Q8_0);
    // The data ends with the last tensor by name, whose blocks begin with a scale in half
    // precision.
    edit(&model, |bytes| {
        let name = b"output.weight";
        let at = bytes
            .windows(name.len())
            .position(|window| window == name)
            .unwrap()
            + name.len();
        let data = bytes.len() - (352 * 34_usize).next_multiple_of(32);
        assert_eq!(bytes[at..at + 4], 2_u32.to_le_bytes());
        bytes[data + 34..data + 36].copy_from_slice(&[0x00, 0x7c]);
    });
    match open(&model).map(|_| ()) {
        Err(MllmError::NonFiniteWeight {
            name, element: 32, ..
        }) => assert_eq!(name, "output.weight"),
        other => panic!("{other:?}"),
    }
}

#[test]
fn a_check_tells_everything_at_once() {
    let copy = Copy::new();
    let registry = registry().with_memory_check(MemoryCheck::Ignore);
    let check = || {
        registry
            .check(&registry.find(copy.folder().to_str().unwrap()).unwrap())
            .unwrap()
    };
    let sound = check();
    assert_eq!(
        (
            sound.problems.as_slice(),
            sound.architecture.map(planagent_mllm::Architecture::name)
        ),
        (&[][..], Some("llava"))
    );
    assert!(sound.memory.unwrap().weights > 280_000 && sound.parameters > 70_000);
    copy.edit_tensors(|tensors| {
        for name in [
            "language_model.model.norm.weight",
            "vision_tower.pre_layrnorm.bias",
        ] {
            tensors.remove(name).unwrap();
        }
        tensors
            .get_mut("multi_modal_projector.linear_1.bias")
            .unwrap()
            .1 = vec![4, 8];
    });
    fs::remove_file(copy.path("chat_template.jinja")).unwrap();
    copy.edit("generation_config.json", |config| {
        config["eos_token_id"] = serde_json::json!(70_000);
    });
    let problems = check().problems;
    for expected in [
        "2 tensors are missing from the checkpoint: ",
        "language_model.norm.weight",
        "vision_tower.pre_layrnorm.bias",
        "has shape [4, 8]",
        "chat_template",
        "70000",
    ] {
        assert!(
            problems.iter().any(|problem| problem.contains(expected)),
            "{expected}: {problems:?}"
        );
    }
    assert_eq!(problems.len(), 4, "{problems:?}");
    copy.edit("config.json", |config| {
        config["text_config"]["num_hidden_layers"] = serde_json::json!(4_000_000);
    });
    let problems = check().problems;
    assert!(
        problems.len() < 10
            && problems
                .iter()
                .any(|problem| problem.contains("num_hidden_layers")),
        "{problems:?}"
    );
}
