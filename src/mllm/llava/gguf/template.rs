//! Chat templates for GGUF files of LLaVA that have none.

use crate::MllmError;
use crate::gguf::{Header, TEMPLATE};

/// Vicuna's questions and answers behind the system prompt (LLaVA 1.5, and 1.6 on Vicuna).
const VICUNA: &str = "\
{%- macro parts(message) -%}
{%- for part in message['content'] -%}{{ '<image>\\n' if part['type'] == 'image' else part['text'] + ' ' }}{%- endfor -%}
{%- endmacro -%}
{%- for message in messages -%}
{{ '' if message['role'] == 'system' else message['role'].upper() + ': ' }}{{ parts(message) }}
{%- endfor -%}
{%- if add_generation_prompt -%}{{ 'ASSISTANT:' }}{%- endif -%}";

/// Mistral's instructions (LLaVA 1.6 on Mistral).
const MISTRAL: &str = "\
{%- macro parts(message) -%}
{%- for part in message['content'] -%}{{ '<image>\\n' if part['type'] == 'image' else part['text'] }}{%- endfor -%}
{%- endmacro -%}
{%- for message in messages -%}
{%- if message['role'] == 'system' -%}{{ '<<SYS>>\\n' + parts(message) + '\\n<</SYS>>\\n\\n' }}
{%- elif message['role'] == 'user' -%}{{ '[INST] ' + parts(message) + ' [/INST]' }}
{%- else -%}{{ ' ' + parts(message) + '</s>' }}
{%- endif -%}
{%- endfor -%}";

/// The chat template of a decoder: the file's own, else one by the model's name, which a note says.
pub(super) fn read<'a>(decoder: &'a Header, notes: &mut Vec<String>) -> Result<&'a str, MllmError> {
    if let Some(template) = decoder.text("tokenizer.chat_template")? {
        return Ok(template);
    }
    let file = decoder
        .path
        .file_stem()
        .unwrap_or_default()
        .to_string_lossy();
    let name = decoder.text("general.name")?.unwrap_or(&file);
    let (template, called) = if name.to_lowercase().contains("mistral") {
        (MISTRAL, "Mistral")
    } else {
        (VICUNA, "Vicuna")
    };
    notes.push(format!(
        "the file has no chat template; it gets that of {called}, by the model's name '{name}' (a {TEMPLATE} beside \
         the file replaces it)"
    ));
    Ok(template)
}
