//! The adapter that TRL and PEFT write opens and gives PEFT's merged logits
//! (`tests/fixtures/make_tiny_lora.py`).

use super::AdapterSpec;
use crate::local::test_reference::{
    LOGIT_TOLERANCE, Reference, difference, fixture, logits_in_pieces,
};
use crate::local::{Loading, LocalModel};
use crate::source::ModelPlace;

#[test]
fn logits_of_an_adapter_that_trl_wrote_are_those_of_merge_and_unload() {
    let folder = fixture("tiny_lora");
    let reference = Reference::open(&folder.join("reference.safetensors"));
    let ids = reference.ids("input_ids", 0);
    let place = ModelPlace::Folder(folder.join("base"));
    let distance = |adapter: Option<AdapterSpec>, name: &str| {
        let loading = Loading {
            adapter,
            ..Loading::default()
        };
        let model = LocalModel::load("tiny", &place, &loading).unwrap();
        let logits = logits_in_pieces(model.model(), &ids, None, &[]);
        let expected = reference.tensor(name);
        let kept = expected.dims()[0];
        let last = logits.narrow(0, logits.dims()[0] - kept, kept).unwrap();
        difference(&last, expected)
    };
    let adapter = || Some(AdapterSpec::new(folder.join("adapter")));
    assert!(distance(None, "base") < LOGIT_TOLERANCE);
    assert!(distance(adapter(), "merged") < LOGIT_TOLERANCE);
    assert!(
        distance(None, "merged") > 0.1,
        "the adapter changes what the model says"
    );
}
