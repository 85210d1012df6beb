//! Checkpoints of `models/learned/train`: what PyTorch trains and exports computes the same here.

use super::exported::{Exported, PLANNERS, Shape, network};
use super::vectors::{NETWORK, assert_close};
use crate::outside::{Needy, python};
use std::path::Path;
use std::process::Command;

#[test]
fn exported_checkpoints_compute_what_pytorch_computes() -> Needy {
    let mut python = Command::new(python(&["torch", "safetensors"])?);
    python.env(
        "PYTHONPATH",
        Path::new(env!("CARGO_MANIFEST_DIR")).join("models/learned/train"),
    );
    let folder = tempfile::tempdir().unwrap();
    let output = python
        .args(["-m", "imitation", "selftest", "--out"])
        .arg(folder.path())
        .output()
        .unwrap();
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    for planner in PLANNERS {
        let file = |kind: &str| folder.path().join(format!("{planner}{kind}.safetensors"));
        let io = Exported::open(&file(".io"));
        let found = network(planner, &file(""), &io, Shape::Small)();
        let mut compared = 0;
        for (name, expected) in io.outputs() {
            let (_, found) = found.iter().find(|(own, _)| own == name).unwrap();
            let finite = |tensor: &candle_core::Tensor| tensor.maximum(-1e9f64).unwrap();
            assert_close(
                &format!("{planner} {name}"),
                &finite(found),
                &finite(expected),
                NETWORK,
            );
            compared += 1;
        }
        assert_eq!(compared, found.len(), "{planner}");
    }
    Ok(())
}
