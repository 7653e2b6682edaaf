//! The merged report of a batch: `batch.json` for machines, `batch.md` for people.

use super::list::Item;
use super::record::{SceneRecord, State};
use crate::core::memory::gibibytes;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

/// All scenes of a list and what became of them.
#[derive(Clone, Debug)]
pub struct Table {
    list: PathBuf,
    rows: Vec<(Item, SceneRecord)>,
}

impl Table {
    /// A table of `records`, one for each of `items`.
    pub(super) fn new(list: &Path, items: &[Item], records: Vec<SceneRecord>) -> Self {
        Self {
            list: list.into(),
            rows: items.iter().cloned().zip(records).collect(),
        }
    }

    /// How many scenes are in a state.
    #[must_use]
    pub fn count(&self, state: State) -> usize {
        self.rows.iter().filter(|r| r.1.state == state).count()
    }

    /// The state of a scene by its index.
    #[must_use]
    pub fn state(&self, index: usize) -> Option<State> {
        self.rows.get(index).map(|r| r.1.state)
    }

    /// The content of `batch.json`.
    #[must_use]
    pub fn json(&self) -> Value {
        let row = |(i, (item, r)): (usize, &(Item, SceneRecord))| {
            json!({
                "index": i,
                "name": item.name,
                "scene": item.scene,
                "flags": item.flags,
                "state": r.state,
                "verdict": r.verdict,
                "expected_error": r.expected_error,
                "seconds": r.seconds,
                "peak_bytes": r.peak_bytes,
                "message": r.message,
                "attempts": r.attempts,
                "worker": r.worker,
            })
        };
        json!({
            "list": self.list,
            "finished": self.count(State::Finished),
            "failed": self.count(State::Failed),
            "started": self.count(State::Started),
            "waiting": self.count(State::Waiting),
            "scenes": self.rows.iter().enumerate().map(row).collect::<Vec<_>>(),
        })
    }

    /// One line: how many scenes are where.
    #[must_use]
    pub fn summary(&self) -> String {
        format!(
            "{} scenes: {} finished, {} failed, {} started and not ended, {} waiting",
            self.rows.len(),
            self.count(State::Finished),
            self.count(State::Failed),
            self.count(State::Started),
            self.count(State::Waiting)
        )
    }

    /// A line for every scene that failed.
    #[must_use]
    pub fn failures(&self) -> String {
        let failed = self.rows.iter().filter(|r| r.1.state == State::Failed);
        failed
            .map(|(item, r)| format!("{}: {}\n", item.name, r.message))
            .collect()
    }

    /// The content of `batch.md`.
    #[must_use]
    pub fn markdown(&self) -> String {
        let mut out = format!(
            "# Batch\n\n{}.\n\n| | scene | state | verdict | expected error | seconds | peak memory | message |\n|---|---|---|---|---|---|---|---|\n",
            self.summary()
        );
        for (i, (item, r)) in self.rows.iter().enumerate() {
            let state = json!(r.state);
            let verdict = r.verdict.map(|v| v.to_string()).unwrap_or_default();
            let number = |x: Option<f64>, digits: usize| {
                x.map(|x| format!("{x:.digits$}")).unwrap_or_default()
            };
            let peak = r.peak_bytes.map(gibibytes);
            let peak = match number(peak, 2) {
                none if none.is_empty() => none,
                some => format!("{some} GiB"),
            };
            out.push_str(&format!(
                "| {i} | {} | {} | {verdict} | {} | {} | {peak} | {} |\n",
                cell(&item.name),
                state.as_str().unwrap_or_default(),
                number(r.expected_error, 3),
                number(r.seconds, 1),
                cell(&r.message)
            ));
        }
        out
    }
}

/// Text that cannot leave its cell.
fn cell(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '|' | '\\' | '`' | '*' | '_' | '[' | '<' | '&' => out.extend(['\\', c]),
            '\n' => out.push_str("; "),
            c if c.is_control() => out.push(' '),
            c => out.push(c),
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::verdict::Level;

    fn item(name: &str) -> Item {
        Item {
            name: name.into(),
            scene: name.into(),
            flags: Vec::new(),
            line: 1,
        }
    }

    #[test]
    fn a_row_a_scene_whatever_its_message() {
        let failed = SceneRecord {
            state: State::Failed,
            message: "a | b\n| evil | row |<script>".into(),
            ..SceneRecord::default()
        };
        let finished = SceneRecord {
            state: State::Finished,
            verdict: Some(Level::Limited),
            expected_error: Some(0.0523),
            seconds: Some(12.34),
            peak_bytes: Some(3 << 29),
            ..SceneRecord::default()
        };
        let items = [item("x|y"), item("z"), item("w")];
        let table = Table::new(
            Path::new("l"),
            &items,
            vec![failed, finished, SceneRecord::default()],
        );
        let text = table.markdown();
        let rows: Vec<&str> = text.lines().filter(|l| l.starts_with('|')).collect();
        assert_eq!(rows.len(), 5, "{text}");
        for row in &rows {
            let bars = row.replace("\\|", "").matches('|').count();
            assert_eq!(bars, 9, "{row}");
        }
        assert_eq!(
            rows[3],
            "| 1 | z | finished | usable with limits | 0.052 | 12.3 | 1.50 GiB |  |"
        );
        let json = table.json();
        assert_eq!((&json["failed"], &json["waiting"]), (&json!(1), &json!(1)));
        assert_eq!(json["scenes"][1]["verdict"], "limited");
        assert!(table.failures().starts_with("x|y: a | b") && !text.contains(" <script"));
    }
}
