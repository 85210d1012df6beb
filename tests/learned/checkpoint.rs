//! Checkpoints as PyTorch and Lightning write them, and files that are none.

use super::vectors::{fixture, manifest_of, tensors};
use candle_core::{DType, Device, Tensor};
use planagent_learned::Checkpoint;
use planagent_learned::pdm_open::{HIDDEN, PdmNetwork};
use std::collections::{BTreeMap, HashMap};
use std::io::Write;
use std::path::Path;

/// Hidden width of the fixtures.
const HIDDEN_SMALL: usize = 2;

fn error_of(path: &Path, hidden: usize) -> String {
    let loaded = Checkpoint::open(path)
        .and_then(|file| file.load("PDM-Open", |weights| PdmNetwork::open(weights, hidden)));
    loaded.map(|_| ()).unwrap_err().to_string()
}

/// The tensors of a file, which must be those of the small PDM-Open.
fn loaded(path: &Path) -> BTreeMap<String, Vec<f32>> {
    let manifest = manifest_of(|weights| PdmNetwork::open(weights, HIDDEN_SMALL));
    let mut found = BTreeMap::new();
    let checkpoint = Checkpoint::open(path).unwrap();
    for (name, _) in &manifest {
        found.insert(name.clone(), checkpoint.numbers(name).unwrap());
    }
    checkpoint
        .load("PDM-Open", |weights| {
            PdmNetwork::open(weights, HIDDEN_SMALL)
        })
        .unwrap();
    found
}

#[test]
fn lightning_and_plain_files_and_safetensors_hold_the_same() {
    let folder = tempfile::tempdir().unwrap();
    let safetensors = folder.path().join("pdm_open.safetensors");
    let expected = tensors(&manifest_of(|weights| {
        PdmNetwork::open(weights, HIDDEN_SMALL)
    }));
    let file: HashMap<String, Tensor> = expected.clone().into_iter().collect();
    candle_core::safetensors::save(&file, &safetensors).unwrap();
    let expected: BTreeMap<String, Vec<f32>> = expected
        .into_iter()
        .map(|(name, tensor)| (name, tensor.flatten_all().unwrap().to_vec1().unwrap()))
        .collect();
    for path in [
        safetensors,
        fixture("checkpoints/lightning.ckpt"),
        fixture("checkpoints/plain.pth"),
    ] {
        assert_eq!(loaded(&path), expected, "{}", path.display());
    }
}

#[test]
fn another_model_is_named_with_all_that_does_not_fit() {
    let error = error_of(&fixture("checkpoints/plain.pth"), HIDDEN);
    assert!(
        error.contains(
            "does not fit PDM-Open: 9 of another shape: state_encoding.0.weight [2, 99] instead of"
        ),
        "{error}"
    );
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("other.safetensors");
    let one = Tensor::zeros(3, DType::F32, &Device::Cpu).unwrap();
    candle_core::safetensors::save(&HashMap::from([("model.other".to_owned(), one)]), &path)
        .unwrap();
    let error = error_of(&path, HIDDEN_SMALL);
    assert!(
        error.contains("10 missing: state_encoding.0.weight"),
        "{error}"
    );
    assert!(error.ends_with("1 left over: other"), "{error}");
}

/// A file in PyTorch's format around a pickle.
fn torch_file(path: &Path, pickle: &[u8], storage: &[u8]) {
    let mut archive = zip::ZipWriter::new(std::fs::File::create(path).unwrap());
    let stored =
        zip::write::SimpleFileOptions::default().compression_method(zip::CompressionMethod::Stored);
    for (name, bytes) in [("a/data.pkl", pickle), ("a/data/0", storage)] {
        archive.start_file(name, stored).unwrap();
        archive.write_all(bytes).unwrap();
    }
    archive.finish().unwrap();
}

#[test]
fn hostile_files_are_one_error_each() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("file");
    let plain: &[(&[u8], &str)] = &[
        (b"", "cannot be read"),
        (b"no checkpoint at all, but some text", "cannot be read"),
        (b"PK\x03\x04 and nothing behind it", "its archive is broken"),
        (&[0xff; 64], "cannot be read"),
        (b"\x80\x02}q\x00.", "PyTorch 1.6 or later"),
    ];
    for (bytes, expected) in plain {
        std::fs::write(&path, bytes).unwrap();
        let error = error_of(&path, HIDDEN_SMALL);
        assert!(error.contains(expected), "{error}");
    }
    assert!(error_of(folder.path(), HIDDEN_SMALL).contains("it is a folder"));
    let deep = [vec![b'N'], vec![0x85; 1 << 20], vec![b'.']].concat();
    // Each pair of instructions doubles what a copying reader would hold.
    let doubling = [
        b"N".to_vec(),
        (0..200u8).flat_map(|i| [b'q', i, b'h', i, 0x86]).collect(),
        b".".to_vec(),
    ]
    .concat();
    let huge_text = [b"X".to_vec(), u32::MAX.to_le_bytes().to_vec()].concat();
    let call = b"cos\nsystem\nX\x04\x00\x00\x00echo\x85R.".to_vec();
    let pickles: [(&[u8], &str); 8] = [
        (&deep, "it holds no tensors"),
        (&doubling, "it holds no tensors"),
        (&huge_text, "ends too early"),
        (&call, "it holds no tensors"),
        (b"\x7f.", "has the unknown instruction 0x7f at byte 0"),
        (b"t.", "takes more values than it has"),
        (b"h\x07.", "names a value that it did not keep"),
        (b"N", "ends too early"),
    ];
    for (pickle, expected) in pickles {
        torch_file(&path, pickle, &[0; 8]);
        let error = error_of(&path, HIDDEN_SMALL);
        assert!(error.contains(expected), "{error}");
    }
}

/// A state with one tensor of this shape and these strides over a storage of two numbers.
fn with_tensor(shape: &[u8], strides: &[u8], offset: u8) -> Vec<u8> {
    let tuple = |sizes: &[u8]| {
        [
            b"(".to_vec(),
            sizes.iter().flat_map(|&size| [b'K', size]).collect(),
            b"t".to_vec(),
        ]
        .concat()
    };
    [
        b"}X\x01\x00\x00\x00ac".to_vec(),
        b"torch._utils\n_rebuild_tensor_v2\n((X\x07\x00\x00\x00storagectorch\nFloatStorage\nX\x01\x00\x00\x000X\x03\x00\x00\x00cpuK\x02tQ".to_vec(),
        vec![b'K', offset],
        tuple(shape),
        tuple(strides),
        b"\x89}tRs.".to_vec(),
    ]
    .concat()
}

#[test]
fn tensors_beyond_their_storage_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("file");
    for (shape, strides, offset, expected) in [
        (&[2u8][..], &[1u8][..], 0, "1 left over: a"),
        (&[2], &[1], 1, "its tensor a lies outside its storage"),
        (&[3], &[1], 0, "its tensor a lies outside its storage"),
        (&[2], &[200], 0, "its tensor a lies outside its storage"),
        (
            &[255, 255],
            &[0, 0],
            0,
            "its tensor a lies outside its storage",
        ),
        (&[255; 8], &[0; 8], 0, "its tensors hold more than"),
    ] {
        torch_file(&path, &with_tensor(shape, strides, offset), &[0; 8]);
        let error = error_of(&path, HIDDEN_SMALL);
        assert!(error.contains(expected), "{error}");
    }
}
