//! What is opened from a cache, in the layouts that tools and people leave behind.

use super::*;
use std::path::Path;

const COMMIT: &str = "0123456789abcdef0123456789abcdef01234567";
const OTHER: &str = "89abcdef0123456789abcdef0123456789abcdef";
const MODEL: HubFiles = HubFiles::Model { tokenizer: true };
const FILES: [&str; 3] = ["config.json", "tokenizer.json", "model.safetensors"];

fn name(word: &str) -> HubName {
    plain(word).unwrap()
}

fn gguf(model: &str, mmproj: Option<&str>) -> HubFiles {
    HubFiles::Gguf {
        model: GgufChoice::File(model.to_owned()),
        mmproj: mmproj.map(str::to_owned),
    }
}

fn offline(cache: &Path) -> HubAccess {
    HubAccess {
        offline: true,
        cache: Some(cache.to_path_buf()),
        // Discard port: any network access fails at once.
        endpoint: Some("http://127.0.0.1:9".into()),
    }
}

/// Adds a snapshot of `org/model`, with copies as on Windows.
fn add_snapshot(cache: &Path, commit: &str, files: &[&str]) {
    let snapshot = cache.join("models--org--model/snapshots").join(commit);
    std::fs::create_dir_all(&snapshot).unwrap();
    for file in files {
        std::fs::write(snapshot.join(file), "{}").unwrap();
    }
}

fn add_ref(cache: &Path, revision: &str, text: &str) {
    let file = cache.join("models--org--model/refs").join(revision);
    std::fs::create_dir_all(file.parent().unwrap()).unwrap();
    std::fs::write(file, text).unwrap();
}

fn cached(files: &[&str]) -> (tempfile::TempDir, HubAccess) {
    let cache = tempfile::tempdir().unwrap();
    add_snapshot(cache.path(), COMMIT, files);
    add_ref(cache.path(), "main", COMMIT);
    let access = offline(cache.path());
    (cache, access)
}

fn folder(access: &HubAccess, word: &str) -> Result<PathBuf, MllmError> {
    Ok(access.fetch(&name(word), &MODEL, None)?.folder)
}

#[test]
fn a_cached_model_is_found_without_network() {
    let (_cache, access) = cached(&FILES);
    for word in [
        "org/model",
        "org/model@main",
        &format!("org/model@{COMMIT}"),
    ] {
        assert!(folder(&access, word).unwrap().ends_with(COMMIT), "{word}");
    }
    let online = HubAccess {
        offline: false,
        ..access
    };
    assert!(
        folder(&online, &format!("org/model@{COMMIT}")).is_ok(),
        "a pinned commit needs no network"
    );
}

#[cfg(feature = "hub")]
#[test]
fn a_hub_that_cannot_be_reached_leaves_the_cache() {
    let (_cache, access) = cached(&FILES);
    let online = HubAccess {
        offline: false,
        // A port that nobody listens on, and no other test asks.
        endpoint: Some("http://127.0.0.1:1".into()),
        ..access
    };
    assert!(folder(&online, "org/model").unwrap().ends_with(COMMIT));
    let started = std::time::Instant::now();
    folder(&online, "org/model").unwrap();
    assert!(
        started.elapsed().as_millis() < 100,
        "the hub is not asked again"
    );
    match folder(&online, "org/other") {
        Err(MllmError::Hub { problem, .. }) => {
            assert!(
                problem.starts_with("cannot connect to http://127.0.0.1:1: "),
                "{problem}"
            );
            assert_eq!(problem.matches("127.0.0.1").count(), 1, "{problem}");
        }
        other => panic!("{other:?}"),
    }
}

#[test]
fn a_ref_may_end_with_a_line_break_and_have_slashes() {
    let cache = tempfile::tempdir().unwrap();
    add_snapshot(cache.path(), COMMIT, &FILES);
    add_snapshot(cache.path(), OTHER, &FILES);
    add_ref(cache.path(), "main", &format!("{COMMIT}\n"));
    add_ref(cache.path(), "v1.0", OTHER);
    add_ref(cache.path(), "refs/pr/3", OTHER);
    add_ref(cache.path(), "89abcde", OTHER);
    let access = offline(cache.path());
    for (word, commit) in [
        ("org/model", COMMIT),
        ("org/model@v1.0", OTHER),
        ("org/model@refs/pr/3", OTHER),
        ("org/model@89abcde", OTHER),
        ("org/model@0123456", COMMIT),
    ] {
        assert!(folder(&access, word).unwrap().ends_with(commit), "{word}");
    }
    assert!(folder(&access, "org/model@v2").is_err());
    assert!(folder(&access, "org/model@fffff").is_err());
}

#[test]
fn a_snapshot_without_refs_opens_where_it_is_the_only_one() {
    let cache = tempfile::tempdir().unwrap();
    let access = offline(cache.path());
    add_snapshot(cache.path(), COMMIT, &FILES);
    assert!(folder(&access, "org/model").unwrap().ends_with(COMMIT));
    add_snapshot(cache.path(), OTHER, &["config.json"]);
    assert!(
        folder(&access, "org/model").unwrap().ends_with(COMMIT),
        "half a snapshot is none"
    );
    add_snapshot(cache.path(), OTHER, &FILES);
    match folder(&access, "org/model") {
        Err(MllmError::NotInCache { advice, .. }) => {
            for commit in [COMMIT, OTHER] {
                assert!(advice.contains(&format!("org/model@{commit}")), "{advice}");
            }
        }
        other => panic!("{other:?}"),
    }
    add_ref(cache.path(), "v1", OTHER);
    assert!(
        folder(&access, "org/model").unwrap().ends_with(COMMIT),
        "a tag is not the default revision"
    );
}

#[test]
fn another_complete_revision_is_named() {
    let cache = tempfile::tempdir().unwrap();
    let access = offline(cache.path());
    add_snapshot(cache.path(), COMMIT, &["config.json"]);
    add_ref(cache.path(), "main", COMMIT);
    add_snapshot(cache.path(), OTHER, &FILES);
    match folder(&access, "org/model") {
        Err(MllmError::NotInCache { file, advice, .. }) => {
            assert_eq!(file, "tokenizer.json");
            assert!(advice.contains(&format!("org/model@{OTHER}")), "{advice}");
        }
        other => panic!("{other:?}"),
    }
}

#[test]
fn an_interrupted_download_is_called_so() {
    let (cache, access) = cached(&["config.json"]);
    let blobs = cache.path().join("models--org--model/blobs");
    std::fs::create_dir_all(&blobs).unwrap();
    std::fs::write(blobs.join("abc.incomplete"), "half").unwrap();
    match folder(&access, "org/model") {
        Err(MllmError::NotInCache { advice, .. }) => {
            assert!(advice.starts_with("an interrupted download"), "{advice}");
            assert_eq!(
                advice.matches("models fetch org/model").count(),
                1,
                "{advice}"
            );
        }
        other => panic!("{other:?}"),
    }
}

#[cfg(unix)]
#[test]
fn links_to_blobs_are_followed() {
    let (cache, access) = cached(&[]);
    let repository = cache.path().join("models--org--model");
    std::fs::create_dir_all(repository.join("blobs")).unwrap();
    for file in FILES {
        std::fs::write(repository.join("blobs").join(file), "{}").unwrap();
        std::os::unix::fs::symlink(
            format!("../../blobs/{file}"),
            repository.join("snapshots").join(COMMIT).join(file),
        )
        .unwrap();
    }
    assert!(folder(&access, "org/model").is_ok());
    std::fs::remove_file(repository.join("blobs/model.safetensors")).unwrap();
    assert!(folder(&access, "org/model").is_err(), "a link to nothing");
}

#[test]
fn the_folder_of_a_repository_in_a_cache_is_its_snapshot() {
    let (cache, _) = cached(&FILES);
    let repository = cache.path().join("models--org--model");
    assert!(snapshot_in(&repository).unwrap().ends_with(COMMIT));
    assert_eq!(snapshot_in(cache.path()), None);
}

#[test]
fn a_repository_without_an_organization_is_taken_from_the_cache() {
    let cache = tempfile::tempdir().unwrap();
    let snapshot = cache.path().join("models--gpt2/snapshots").join(COMMIT);
    std::fs::create_dir_all(&snapshot).unwrap();
    for file in FILES {
        std::fs::write(snapshot.join(file), "{}").unwrap();
    }
    for is_offline in [true, false] {
        let access = HubAccess {
            offline: is_offline,
            ..offline(cache.path())
        };
        for word in ["gpt2", "hf.co/gpt2", &format!("gpt2@{COMMIT}")] {
            let name = access.cached_without_owner(word).unwrap();
            let place = access.fetch(&name, &MODEL, None).unwrap();
            assert!(place.folder.ends_with(COMMIT), "{word}");
        }
        assert_eq!(access.cached_without_owner("other"), None);
        let name = access.cached_without_owner("gpt2@v2").unwrap();
        match access.fetch(&name, &MODEL, None) {
            Err(MllmError::NotInCache { advice, .. }) => {
                assert!(advice.contains(&format!("gpt2@{COMMIT}")), "{advice}");
                assert!(
                    advice.ends_with("its organization: ORG/gpt2@v2"),
                    "{advice}"
                );
            }
            other => panic!("{other:?}"),
        }
    }
}

#[test]
fn a_model_and_its_tokenizer_may_lie_apart() {
    let weights = HubFiles::Model { tokenizer: false };
    let (_cache, access) = cached(&["config.json", "model.safetensors"]);
    assert!(access.fetch(&name("org/model"), &weights, None).is_ok());
    let missing = access.fetch(&name("org/model"), &HubFiles::Tokenizer, None);
    assert!(matches!(missing, Err(MllmError::NotInCache { file, .. }) if file == "tokenizer.json"));
    let (_cache, access) = cached(&["tokenizer.json"]);
    assert!(
        access
            .fetch(&name("org/model"), &HubFiles::Tokenizer, None)
            .is_ok()
    );
}

#[test]
fn gguf_files_are_asked_for_by_name_or_format() {
    let (_cache, access) = cached(&["model-q4_k.gguf", "model-Q8_0.gguf", "mmproj.gguf"]);
    let names = |files: &HubFiles| {
        let place = access.fetch(&name("org/model"), files, None)?;
        Ok::<_, MllmError>(place.gguf.unwrap())
    };
    let found = names(&gguf("model-q4_k.gguf", None)).unwrap();
    assert_eq!(found.mmproj.as_deref(), Some("mmproj.gguf"));
    assert!(names(&gguf("model-q4_k.gguf", Some("mmproj.gguf"))).is_ok());
    let quant = HubFiles::Gguf {
        model: GgufChoice::Quant("q8_0".into()),
        mmproj: None,
    };
    assert_eq!(names(&quant).unwrap().model, "model-Q8_0.gguf");
    let missing = names(&gguf("model-q4_k.gguf", Some("mmproj-f16.gguf")));
    assert!(
        matches!(&missing, Err(MllmError::NotInCache { file, .. }) if file == "mmproj-f16.gguf"),
        "{missing:?}"
    );
    match folder(&access, "org/model") {
        Err(MllmError::Hub { problem, .. }) => assert!(
            problem.contains("org/model/model-Q8_0.gguf") && !problem.contains("model/mmproj"),
            "{problem}"
        ),
        other => panic!("{other:?}"),
    }
}

#[test]
fn what_is_not_cached_is_named() {
    let (_cache, access) = cached(&["config.json", "tokenizer.json"]);
    for (word, missing) in [
        ("org/model", "model.safetensors"),
        ("org/model@v2", "config.json"),
        ("org/other", "config.json"),
    ] {
        match folder(&access, word) {
            Err(MllmError::NotInCache { file, .. }) => assert_eq!(file, missing),
            other => panic!("{word}: {other:?}"),
        }
    }
    let outside = HubName {
        id: "../x/y".into(),
        ..HubName::default()
    };
    assert!(matches!(
        access.fetch(&outside, &MODEL, None),
        Err(MllmError::Hub { .. })
    ));
    let outside = HubName {
        id: "org/model".into(),
        revision: Some("../refs/main".into()),
        ..HubName::default()
    };
    assert!(access.fetch(&outside, &MODEL, None).is_err());
}
