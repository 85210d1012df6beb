//! Models are found by name, and what is wrong with one is said.

use super::*;

fn registry() -> (tempfile::TempDir, ModelRegistry) {
    let models = tempfile::tempdir().unwrap();
    let described = "name = 'Nano'\narchitecture = 'llava'\nsource = { folder = 'weights' }\nprompt_set = 'compact'\n";
    std::fs::write(models.path().join("nano.toml"), described).unwrap();
    std::fs::write(models.path().join("broken.toml"), "name = 3").unwrap();
    let registry = ModelRegistry::new(
        models.path(),
        HubAccess {
            offline: true,
            ..HubAccess::default()
        },
    );
    (models, registry)
}

#[test]
fn names_folders_and_ids_are_found() {
    let (models, registry) = registry();
    let names = registry.names().unwrap();
    assert!(
        names.is_sorted()
            && ["broken", "nano", "openai"]
                .iter()
                .all(|name| names.iter().any(|n| n == name))
    );
    let nano = registry.find("nano").unwrap();
    assert_eq!(
        (nano.name.as_str(), nano.prompt_set.clone()),
        ("Nano", Some(DescribedPrompts::Known(PromptSet::Compact)))
    );
    assert_eq!(
        registry.place(&nano).unwrap(),
        ModelPlace::Folder(models.path().join("weights"))
    );
    let by_path = models.path().join("nano.toml");
    assert_eq!(registry.find(by_path.to_str().unwrap()).unwrap(), nano);
    let folder = registry.find(models.path().to_str().unwrap()).unwrap();
    assert_eq!(
        folder.source,
        ModelSource::Folder {
            folder: models.path().to_path_buf()
        }
    );
    let hub = registry.find("llava-hf/llava-1.5-7b-hf").unwrap();
    assert_eq!(hub.name, "llava-1.5-7b-hf");
    assert!(matches!(hub.source, ModelSource::Hub { file: None, .. }));
    let in_hub = registry.find("org/repo/sub/model-q4_k.gguf").unwrap();
    match in_hub.source {
        ModelSource::Hub {
            hub,
            file: Some(file),
            ..
        } => {
            assert_eq!(
                (hub.as_str(), file.as_str()),
                ("org/repo", "sub/model-q4_k.gguf")
            );
        }
        other => panic!("{other:?}"),
    }
    for (word, name, shown) in [
        ("org/repo:Q4_K_M", "repo:Q4_K_M", "org/repo:Q4_K_M"),
        ("hf.co/org/repo:q8_0", "repo:q8_0", "org/repo:q8_0"),
        (
            "org/repo@refs/pr/1",
            "repo@refs-pr-1",
            "org/repo (refs/pr/1)",
        ),
        ("https://huggingface.co/org/repo", "repo", "org/repo"),
        (" org/repo/ ", "repo", "org/repo"),
        ("models--org--repo", "repo", "org/repo"),
        (
            "https://huggingface.co/org/repo/blob/main/m-q4_k.gguf",
            "m-q4_k.gguf",
            "org/repo/m-q4_k.gguf",
        ),
    ] {
        let spec = registry.find(word).unwrap();
        assert_eq!(
            (spec.name.as_str(), spec.source.to_string().as_str()),
            (name, shown),
            "{word}"
        );
    }
    assert!(matches!(
        registry.find("https://huggingface.co/spaces/org/app"),
        Err(MllmError::HubName { .. })
    ));
    let file = models.path().join("model.gguf");
    std::fs::write(&file, "GGUF").unwrap();
    let here = registry.find(file.to_str().unwrap()).unwrap();
    assert_eq!(here.source, ModelSource::File { file, mmproj: None });
}

#[cfg(feature = "nano")]
#[test]
fn the_embedded_nano_is_that_of_the_folder() {
    let open = |models: &Path| {
        let registry = ModelRegistry::new(
            models,
            HubAccess {
                offline: true,
                ..HubAccess::default()
            },
        );
        registry
            .open(&registry.find("nano").unwrap())
            .unwrap()
            .describe()
    };
    let nowhere = tempfile::tempdir().unwrap();
    let repository = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../models");
    assert_eq!(open(nowhere.path()), open(&repository));
}

#[test]
fn the_descriptions_in_the_program_are_those_of_the_folder() {
    let nowhere = tempfile::tempdir().unwrap();
    let repository = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../models");
    let [bare, full] = [nowhere.path(), repository.as_path()]
        .map(|models| ModelRegistry::new(models, HubAccess::default()));
    assert_eq!(bare.names().unwrap(), full.names().unwrap());
    for name in built_in::names() {
        assert_eq!(bare.find(name).unwrap(), full.find(name).unwrap());
    }
}

#[test]
fn every_description_that_ships_is_read() {
    let models = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../models");
    let registry = ModelRegistry::new(
        &models,
        HubAccess {
            offline: true,
            ..HubAccess::default()
        },
    );
    let names = registry.names().unwrap();
    let servers = names
        .iter()
        .filter(|name| match registry.find(name).unwrap().source {
            ModelSource::Endpoint(settings) => settings.url().is_ok(),
            _ => false,
        });
    assert_eq!(servers.collect::<Vec<_>>(), ["local-server", "openai"]);
    let openai = registry.find("openai").unwrap();
    assert!(
        matches!(registry.open(&openai), Err(MllmError::Offline { .. })),
        "the network is off"
    );
    assert!(matches!(
        registry.place(&openai),
        Err(MllmError::NoFiles { .. })
    ));
    let local = registry
        .open(&registry.find("local-server").unwrap())
        .unwrap();
    assert_eq!(local.describe().server.unwrap().model, "default");
}

#[test]
fn unknown_and_broken_models_are_errors() {
    let (_models, registry) = registry();
    match registry.find("nanoo") {
        Err(MllmError::UnknownModel { known, .. }) => {
            assert!(
                known.starts_with("broken, ") && known.contains(", nano, "),
                "{known}"
            );
        }
        other => panic!("{other:?}"),
    }
    for name in ["", "a b", "a/b/c", "a.example:80/v1"] {
        assert!(
            matches!(registry.find(name), Err(MllmError::UnknownModel { .. })),
            "{name}"
        );
    }
    for name in [
        "../no-such-folder/nano",
        "/nowhere/nano",
        "a/b/../c.gguf",
        "nowhere.gguf",
        "nowhere.toml",
    ] {
        assert!(
            matches!(registry.find(name), Err(MllmError::AbsentModel { .. })),
            "{name}"
        );
    }
    assert!(matches!(
        registry.find("broken"),
        Err(MllmError::Description { .. })
    ));
    let nano = registry.find("nano").unwrap();
    assert!(matches!(
        registry.open(&nano),
        Err(MllmError::MissingFile { .. })
    ));
}

#[test]
fn a_file_or_a_folder_near_a_model_leads_to_it() {
    let registry = ModelRegistry::new("/nowhere", HubAccess::default());
    let root = tempfile::tempdir().unwrap();
    let at = |path: &str| root.path().join(path).to_str().unwrap().to_owned();
    std::fs::create_dir_all(at("outer/m")).unwrap();
    std::fs::create_dir_all(at("empty")).unwrap();
    std::fs::create_dir_all(at("half/original")).unwrap();
    for (file, text) in [
        ("outer/m/config.json", "{}"),
        ("outer/m/model.safetensors", "x"),
        ("half/model-00001-of-00002.safetensors", "x"),
        ("half/original/config.json", "{}"),
        ("sha256-0123", "GGUF\u{3}"),
        ("a.tar", "PK\u{3}\u{4}"),
        ("alone.safetensors", "<!DOCTYPE html>"),
        ("m.gguf.part", "half"),
    ] {
        std::fs::write(at(file), text).unwrap();
    }
    for file in [
        "outer/m",
        "outer/m/config.json",
        "outer/m/model.safetensors",
    ] {
        let spec = registry.find(&at(file)).unwrap();
        let folder = PathBuf::from(at("outer/m"));
        assert_eq!(
            (spec.name.as_str(), spec.source),
            ("m", ModelSource::Folder { folder }),
            "{file}"
        );
    }
    let blob = registry.find(&at("sha256-0123")).unwrap();
    assert!(matches!(blob.source, ModelSource::File { .. }));
    let said = |word: &str| registry.find(&at(word)).unwrap_err().to_string();
    assert!(said("outer").ends_with(&format!("name one of {}", at("outer/m"))));
    for (file, kind) in [
        ("a.tar", "a ZIP archive"),
        ("alone.safetensors", "a web page"),
        ("m.gguf.part", "is no model: name a folder"),
    ] {
        let said = said(file);
        assert!(
            said.contains(kind) && said.contains("name a folder"),
            "{said}"
        );
    }
    for folder in ["empty", "half"] {
        let found = registry.find(&at(folder));
        assert!(found.is_ok(), "{folder}: opening it says what it lacks");
    }
}
