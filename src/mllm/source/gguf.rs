//! Opens GGUF files as a model of a family.

use super::Checkpoint;
use crate::MllmError;
use crate::checkpoint::{
    FileKind, ModelFiles, OwnKeys, RowOrder, WeightFile, WeightFormatPlan, Weights,
};
use crate::families::Families;
use crate::gguf::{
    GgufLayout, Header, TEMPLATE, TILED_HEADS, TOWER, WHOLE_MODEL, llama, no_tower, open_header,
    open_model, packed_files, row_order, tokenizer, tower_for, unread_keys,
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
    let (header, parts) = open_model(model)?;
    if header.architecture()? == WHOLE_MODEL {
        return open_whole(&header, parts, quantize, families);
    }
    check_decoder(&header)?;
    let Some(beside) = tower_for(&header, mmproj)? else {
        return open_files((&header, parts), None, quantize, families);
    };
    let (tower, tower_file) = open_header(&beside)?;
    if tower.architecture()? != TOWER {
        return Err(tower.error(ARCHITECTURE, "this is no vision tower (clip)"));
    }
    let tower = (&tower, vec![tower_file]);
    open_files((&header, parts), Some(tower), quantize, families)
}

/// Opens a decoder as a language model, also where it is part of a vision model.
pub(super) fn open_decoder(
    model: &Path,
    quantize: Option<WeightFormat>,
    families: &Families,
) -> Result<Checkpoint, MllmError> {
    let (header, parts) = open_model(model)?;
    if header.architecture()? == WHOLE_MODEL {
        let problem =
            "this file holds a whole model, whose decoder cannot be opened alone (vision = false)";
        return Err(header.error(ARCHITECTURE, problem));
    }
    check_decoder(&header)?;
    open_files((&header, parts), None, quantize, families)
}

const ARCHITECTURE: &str = "general.architecture";

/// Checks that a file is a decoder of a known architecture.
fn check_decoder(header: &Header) -> Result<(), MllmError> {
    let problem = match header.architecture()? {
        decoder if llama::architectures().any(|known| known == decoder) => return Ok(()),
        TOWER => "this is a vision tower (mmproj); name the file of the decoder instead".to_owned(),
        other => format!(
            "'{other}' is not supported; decoders of architecture {} are",
            llama::architectures().collect::<Vec<_>>().join(", ")
        ),
    };
    Err(header.error(ARCHITECTURE, problem))
}

fn plan(quantize: Option<WeightFormat>) -> WeightFormatPlan {
    WeightFormatPlan {
        quantize,
        kind: FileKind::Gguf,
        tied: true,
        whole_blocks: false,
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
    if header.flag(TILED_HEADS)? == Some(true) {
        weights.set_heads_are_tiled();
    }
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

/// A file's header over all of its parts, and these.
type Opened<'a> = (&'a Header, Vec<WeightFile>);

/// A decoder, and a tower where it has one, from llama.cpp or from this program.
fn open_files(
    decoder: Opened<'_>,
    tower: Option<Opened<'_>>,
    quantize: Option<WeightFormat>,
    families: &Families,
) -> Result<Checkpoint, MllmError> {
    let mut notes = Vec::new();
    let tower_header = tower.as_ref().map(|(header, _)| *header);
    // First, because the configuration made from both headers tells the family, and that the
    // layout.
    let files = small_files(decoder.0, tower_header, families, &mut notes)?;
    let decoder_header = decoder.0;
    let family = families.detect_in(&files)?;
    let layout = family.family().gguf.map_err(|lacking| {
        decoder_header.error(
            ARCHITECTURE,
            format!("a decoder file of llama.cpp has no place for {lacking}"),
        )
    })?;
    if tower.is_none() {
        if !layout.opens(decoder_header, None) {
            return Err(no_tower(decoder_header, "the configuration that it holds"));
        }
        notes.push(format!(
            "{} has no vision tower: it is opened as a language model, which reads text and sees no picture",
            decoder_header.path.display()
        ));
    }
    let mut weights = Weights::empty(&decoder_header.path, plan(quantize));
    if layout.norms_have_one() {
        weights.set_norms_have_one();
    }
    if layout.heads_are_tiled() {
        weights.set_heads_are_tiled();
    }
    for (header, parts) in [Some(decoder), tower].into_iter().flatten() {
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

/// The small files of a decoder and its tower: those that the decoder holds, else made from the
/// metadata, and replaced by those that lie beside it.
fn small_files(
    decoder: &Header,
    tower: Option<&Header>,
    families: &Families,
    notes: &mut Vec<String>,
) -> Result<ModelFiles, MllmError> {
    let model = decoder.path.as_path();
    let mut texts = packed_files(decoder)?;
    let is_made = !texts.contains_key(CONFIG);
    // A file of llama.cpp may say how the model is asked, and nothing else.
    if is_made {
        let layouts = families
            .iter()
            .filter_map(|family| family.family().gguf.ok());
        let layout = layouts
            .into_iter()
            .find(|layout| layout.opens(decoder, tower))
            .map_or_else(|| Err(unknown_pair(decoder, tower)?), Ok)?;
        texts.extend(layout.small_files(decoder, tower, notes)?);
        let block_count = format!("{}.block_count", decoder.architecture()?);
        check_layers(decoder, &block_count, "blk.", true)?;
        if let Some(tower) = tower.filter(|_| layout.tower_says_its_layers()) {
            // Older files of LLaVA have the layer that is not used.
            check_layers(tower, "clip.vision.block_count", "v.blk.", false)?;
        }
        notes.extend(tokenizer::note(decoder)?);
        for header in [Some(decoder), tower].into_iter().flatten() {
            unread_keys::check(header, notes)?;
        }
    }
    let mut files = ModelFiles::packed(model, texts);
    if is_made {
        files = files.made_from(OwnKeys {
            architecture: decoder.architecture()?.to_owned(),
            decoder: model.to_path_buf(),
            tower: tower.map(|tower| tower.path.clone()),
        });
    }
    files.prefer(model.parent().unwrap_or(Path::new("")), &BESIDE)?;
    Ok(files)
}

/// Checks that a file has no more layers than it says, unless `all` is false: the model would be
/// another one without a word. And that it has no fewer.
fn check_layers(header: &Header, key: &str, prefix: &str, all: bool) -> Result<(), MllmError> {
    let count = header.required_count(key)?;
    let number = |name: &str| {
        let (number, _) = name.strip_prefix(prefix)?.split_once('.')?;
        number.parse::<usize>().ok()
    };
    let numbers = header.tensors.keys().filter_map(|name| number(name));
    let problem = match numbers.max() {
        Some(last) if last >= count && all => {
            format!("is {count}, and the file has a tensor of layer {last} (from 0)")
        }
        Some(last) if last + 1 < count => {
            format!("is {count}, and the last layer of the file is {last} (from 0)")
        }
        _ => return Ok(()),
    };
    Err(header.error(key, problem))
}

/// The error of a decoder and a tower that no family has.
fn unknown_pair(decoder: &Header, tower: Option<&Header>) -> Result<MllmError, MllmError> {
    let architecture = decoder.architecture()?;
    let Some(tower) = tower else {
        let problem = format!("no known model family has a decoder '{architecture}' alone");
        return Ok(decoder.error(ARCHITECTURE, problem));
    };
    let problem = match tower.projector()? {
        Some(kind) => {
            format!("'{kind}' is not supported with a decoder of architecture {architecture}")
        }
        None => format!(
            "is missing from the metadata (newer files: clip.vision.projector_type), and no known model family has \
             such a vision tower beside a decoder of architecture {architecture}"
        ),
    };
    let hint = "`vision = false` in the model's description opens the decoder alone, as a language model that sees nothing";
    Ok(tower.error("clip.projector_type", format!("{problem}; {hint}")))
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
