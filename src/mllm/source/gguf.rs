//! Opens GGUF files as a model of a family.

use super::Checkpoint;
use crate::MllmError;
use crate::checkpoint::{FileKind, ModelFiles, RowOrder, WeightFile, WeightFormatPlan, Weights};
use crate::families::Families;
use crate::gguf::{
    GgufLayout, Header, TEMPLATE, TOWER, WHOLE_MODEL, llama, open_header, packed_files, row_order,
    tokenizer, tower_beside,
};
use planagent_kernels::matrix::WeightFormat;
use std::path::Path;

/// The small file that every model of this program's own has.
const CONFIG: &str = "config.json";
/// Small files that a user may put beside a GGUF file.
const BESIDE: [&str; 3] = [
    "tokenizer_config.json",
    "preprocessor_config.json",
    TEMPLATE,
];

/// Opens a model: its decoder, and its vision tower, by default the one that lies beside it.
pub(super) fn open(
    model: &Path,
    mmproj: Option<&Path>,
    quantize: Option<WeightFormat>,
    families: &Families,
) -> Result<Checkpoint, MllmError> {
    const ARCHITECTURE: &str = "general.architecture";
    let (header, file) = open_header(model)?;
    header.check_one_file()?;
    match header.architecture()? {
        WHOLE_MODEL => open_whole(&header, file, quantize, families),
        decoder if llama::architectures().any(|known| known == decoder) => {
            let beside =
                mmproj.map_or_else(|| tower_beside(model), |mmproj| Ok(mmproj.to_path_buf()))?;
            let (tower, tower_file) = open_header(&beside)?;
            if tower.architecture()? != TOWER {
                return Err(tower.error(ARCHITECTURE, "this is no vision tower (clip)"));
            }
            open_pair([(&header, file), (&tower, tower_file)], quantize, families)
        }
        TOWER => Err(header.error(
            ARCHITECTURE,
            "this is a vision tower (mmproj); name the file of the decoder instead",
        )),
        other => Err(header.error(
            ARCHITECTURE,
            format!(
                "'{other}' is not supported; decoders of architecture {} are",
                llama::architectures().collect::<Vec<_>>().join(", ")
            ),
        )),
    }
}

fn plan(quantize: Option<WeightFormat>) -> WeightFormatPlan {
    WeightFormatPlan {
        quantize,
        kind: FileKind::Gguf,
        tied: true,
    }
}

/// A file that this program wrote, with the whole model under its canonical names.
fn open_whole(
    header: &Header,
    file: WeightFile,
    quantize: Option<WeightFormat>,
    families: &Families,
) -> Result<Checkpoint, MllmError> {
    let files = ModelFiles::packed(&header.path, packed_files(header)?);
    let mut weights = Weights::empty(&header.path, plan(quantize));
    let index = weights.add_file(file);
    for (name, place) in &header.tensors {
        weights.add(
            name.clone(),
            index,
            name.clone(),
            place.clone(),
            RowOrder::Plain,
        )?;
    }
    Ok(Checkpoint {
        family: families.detect_in(&files)?,
        files,
        weights,
    })
}

/// A decoder and a tower, from llama.cpp or from this program.
fn open_pair(
    pair: [(&Header, WeightFile); 2],
    quantize: Option<WeightFormat>,
    families: &Families,
) -> Result<Checkpoint, MllmError> {
    let [(decoder, _), (tower, _)] = &pair;
    let model = decoder.path.as_path();
    let mut notes = Vec::new();
    let mut texts = packed_files(decoder)?;
    // A file of llama.cpp may say how the model is asked, and nothing else.
    if !texts.contains_key(CONFIG) {
        let layouts = families
            .iter()
            .filter_map(|family| family.family().gguf.ok());
        let Some(layout) = layouts
            .into_iter()
            .find(|layout| layout.opens(decoder, tower))
        else {
            let problem = match tower.projector()? {
                Some(kind) => {
                    format!(
                        "'{kind}' is not supported with a decoder of architecture {}",
                        decoder.architecture()?
                    )
                }
                None => "no known model family has such a vision tower".into(),
            };
            return Err(tower.error("clip.projector_type", problem));
        };
        texts.extend(layout.small_files(decoder, tower, &mut notes)?);
        notes.extend(tokenizer::note(decoder)?);
    }
    let mut files = ModelFiles::packed(model, texts);
    files.prefer(model.parent().unwrap_or(Path::new("")), &BESIDE)?;
    let family = families.detect_in(&files)?;
    let layout = family.family().gguf.map_err(|lacking| {
        decoder.error(
            "general.architecture",
            format!("a decoder file of llama.cpp has no place for {lacking}"),
        )
    })?;
    let mut weights = Weights::empty(model, plan(quantize));
    for (header, file) in pair {
        add_tensors(&mut weights, layout, header, file)?;
    }
    for note in notes {
        weights.note(note);
    }
    Ok(Checkpoint {
        family,
        files,
        weights,
    })
}

/// Adds the tensors of a file of llama.cpp under their canonical names.
fn add_tensors(
    weights: &mut Weights,
    layout: &dyn GgufLayout,
    header: &Header,
    file: WeightFile,
) -> Result<(), MllmError> {
    let index = weights.add_file(file);
    for (name, place) in &header.tensors {
        match layout.canonical_name(header, name)? {
            Some(canonical) => {
                let rows = row_order(header, name, place)?;
                weights.add(canonical, index, name.clone(), place.clone(), rows)?;
            }
            None => weights.note(format!(
                "{}: tensor {name} is not used",
                header.path.display()
            )),
        }
    }
    Ok(())
}
