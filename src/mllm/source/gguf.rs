//! Opens GGUF files as a model of a family.

use super::Checkpoint;
use crate::MllmError;
use crate::checkpoint::{
    FileKind, ModelFiles, OwnKeys, RowOrder, WeightFile, WeightFormatPlan, Weights,
};
use crate::families::Families;
use crate::gguf::{
    GgufLayout, Header, TEMPLATE, TOWER, WHOLE_MODEL, llama, open_header, open_model, packed_files,
    row_order, tokenizer, tower_beside, unread_keys,
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
    let (header, parts) = open_model(model)?;
    match header.architecture()? {
        WHOLE_MODEL => open_whole(&header, parts, quantize, families),
        decoder if llama::architectures().any(|known| known == decoder) => {
            let beside = mmproj.map_or_else(
                || tower_beside(&header.path),
                |mmproj| Ok(mmproj.to_path_buf()),
            )?;
            let (tower, tower_file) = open_header(&beside)?;
            if tower.architecture()? != TOWER {
                return Err(tower.error(ARCHITECTURE, "this is no vision tower (clip)"));
            }
            let pair = [(&header, parts), (&tower, vec![tower_file])];
            open_pair(pair, quantize, families)
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
    parts: Vec<WeightFile>,
    quantize: Option<WeightFormat>,
    families: &Families,
) -> Result<Checkpoint, MllmError> {
    let files = ModelFiles::packed(&header.path, packed_files(header)?);
    let mut weights = Weights::empty(&header.path, plan(quantize));
    let first = add_parts(&mut weights, parts);
    for (name, place) in &header.tensors {
        weights.add(
            name.clone(),
            first + header.part_of(name),
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
    pair: [(&Header, Vec<WeightFile>); 2],
    quantize: Option<WeightFormat>,
    families: &Families,
) -> Result<Checkpoint, MllmError> {
    let [(decoder, _), (tower, _)] = &pair;
    let model = decoder.path.as_path();
    let mut notes = Vec::new();
    let mut texts = packed_files(decoder)?;
    let is_made = !texts.contains_key(CONFIG);
    // A file of llama.cpp may say how the model is asked, and nothing else.
    if is_made {
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
        for header in [decoder, tower] {
            unread_keys::check(header, &mut notes)?;
        }
    }
    let mut files = ModelFiles::packed(model, texts);
    if is_made {
        files = files.made_from(OwnKeys {
            architecture: decoder.architecture()?.to_owned(),
            decoder: model.to_path_buf(),
            tower: tower.path.clone(),
        });
    }
    files.prefer(model.parent().unwrap_or(Path::new("")), &BESIDE)?;
    let family = families.detect_in(&files)?;
    let layout = family.family().gguf.map_err(|lacking| {
        decoder.error(
            "general.architecture",
            format!("a decoder file of llama.cpp has no place for {lacking}"),
        )
    })?;
    let mut weights = Weights::empty(model, plan(quantize));
    for (header, parts) in pair {
        add_tensors(&mut weights, layout, header, parts)?;
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

/// Adds the files of a model, and gives the index of the first.
fn add_parts(weights: &mut Weights, parts: Vec<WeightFile>) -> usize {
    let indices: Vec<usize> = parts
        .into_iter()
        .map(|part| weights.add_file(part))
        .collect();
    indices.first().copied().unwrap_or(0)
}

/// Adds the tensors of a file of llama.cpp under their canonical names.
fn add_tensors(
    weights: &mut Weights,
    layout: &dyn GgufLayout,
    header: &Header,
    parts: Vec<WeightFile>,
) -> Result<(), MllmError> {
    let first = add_parts(weights, parts);
    for (name, place) in &header.tensors {
        match layout.canonical_name(header, name)? {
            Some(canonical) => {
                let rows = row_order(header, name, place)?;
                let index = first + header.part_of(name);
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
