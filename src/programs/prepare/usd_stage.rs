//! Composition: one tree of prims out of the opinions of many layers.
//!
//! A prim's opinions are its *sites*, places in stacks of layers, the strongest first. USD orders
//! them as LIVRPS: the stack's own layers (with sublayers, the stronger first), then what the prim
//! inherits, its selected variants, references, payloads and specializes, each composed in the same
//! way (OpenUSD, "LIVRPS Strength Ordering"). A property has the value of the strongest site that
//! states it; children are merged by name. Called by `roomplan` and `usd_mesh`.
//!
//! Left out: value clips, offsets of time, relocates, and classes that are overridden across
//! references ("implied inherits").

use super::usd_files::{Files, relative};
use super::usd_layer::{Prim, Specifier, Target, Value};
use crate::error::{Error, Result};
use std::cell::{Cell, RefCell};
use std::collections::BTreeMap;
use std::path::Path;
use std::rc::Rc;

/// References within references beyond this are a circle.
const DEEPEST: usize = 32;
/// Most sites in all: references that double at every step would never end. Derived: some seconds.
const MOST_SITES: usize = 1 << 22;
/// Most sites of one prim, which are held at once. Derived: 2¹² take 1 MB.
const MOST_SITES_OF_PRIM: usize = 1 << 12;

/// A layer and its sublayers, the strongest first.
struct Stack {
    layers: Vec<Layer>,
}

struct Layer {
    path: String,
    root: Rc<Prim>,
}

/// What one layer says about a prim.
#[derive(Clone)]
struct Spec {
    prim: Rc<Prim>,
    /// The layer's place in its stack.
    layer: usize,
}

/// Where a reference brings the paths below its target.
struct Move {
    from: String,
    to: String,
}

/// Where a prim has opinions: a path in a stack of layers.
#[derive(Clone)]
struct Site {
    stack: Rc<Stack>,
    path: String,
    specs: Vec<Spec>,
    /// How paths of this stack become paths of the stage, one after the other.
    moves: Vec<Rc<Move>>,
    /// References and the like on the way here.
    arcs: usize,
}

impl Site {
    /// The prim `name` below this site, if any layer speaks of it.
    fn child(&self, name: &str) -> Option<Self> {
        let specs: Vec<Spec> = (self.specs.iter())
            .flat_map(|s| {
                let named = s.prim.children.iter().filter(|c| c.name == name);
                named.map(|c| Spec {
                    prim: Rc::clone(c),
                    layer: s.layer,
                })
            })
            .collect();
        self.with_specs(name, specs)
    }

    fn with_specs(&self, name: &str, specs: Vec<Spec>) -> Option<Self> {
        (!specs.is_empty()).then(|| Self {
            path: format!("{}/{name}", self.path),
            specs,
            ..self.clone()
        })
    }

    /// The targets of one kind of arc, as edited layer by layer; files by their path for the stage.
    fn targets(&self, kind: &str) -> Vec<Target> {
        let mut list = Vec::new();
        for spec in self.specs.iter().rev() {
            let Some(value) = spec.prim.metadata.get(kind) else {
                continue;
            };
            let layer = &self.stack.layers[spec.layer].path;
            let mut edits = value.edits();
            let lists = [
                edits.explicit.as_mut(),
                Some(&mut edits.prepended),
                Some(&mut edits.appended),
                Some(&mut edits.deleted),
            ];
            for value in lists.into_iter().flatten().flatten() {
                if let Value::Target(t) = value
                    && !t.asset.is_empty()
                {
                    t.asset = relative(layer, &t.asset);
                }
            }
            list = edits.applied_to(list);
        }
        (list.into_iter())
            .filter_map(|v| match v {
                Value::Target(t) => Some(t),
                _ => None,
            })
            .collect()
    }

    /// The variants selected by `choices`, in the order of their sets.
    fn variants(&self, choices: &Choices) -> Vec<Self> {
        let mut sets: Vec<&str> = Vec::new();
        let listed = self.specs.iter().filter_map(|s| {
            let value = s.prim.metadata.get("variantSets")?;
            Some(value.edits().applied_to(Vec::new()))
        });
        let listed: Vec<Value> = listed.flatten().collect();
        let defined = (self.specs.iter()).flat_map(|s| s.prim.variant_sets.iter());
        let names = listed.iter().filter_map(Value::text);
        for name in names.chain(defined.map(|set| set.name.as_str())) {
            if !sets.contains(&name) {
                sets.push(name);
            }
        }
        let variant = |set: &str| {
            let choice = choices.get(set)?;
            let specs: Vec<Spec> = (self.specs.iter())
                .flat_map(|s| {
                    let sets = s.prim.variant_sets.iter().filter(|v| v.name == set);
                    let named = sets.flat_map(|v| &v.variants).filter(|v| v.name == *choice);
                    named.map(|v| Spec {
                        prim: Rc::clone(v),
                        layer: s.layer,
                    })
                })
                .collect();
            (!specs.is_empty()).then(|| Self {
                specs,
                arcs: self.arcs + 1,
                ..self.clone()
            })
        };
        sets.into_iter().filter_map(variant).collect()
    }

    /// Where a path of this stack lies on the stage.
    fn moved(&self, path: &str) -> String {
        let mut path = match path.strip_prefix('/') {
            Some(_) => path.to_owned(),
            None => relative(&format!("{}/", self.path), path),
        };
        for step in &self.moves {
            if let Some(rest) = path.strip_prefix(&step.from)
                && (rest.is_empty() || rest.starts_with('/'))
            {
                path = format!("{}{rest}", step.to);
            }
        }
        path
    }
}

/// Selected variants by the name of their set; the strongest opinion came first.
type Choices = BTreeMap<String, String>;

/// A prim of the stage.
pub struct Composed {
    /// Path on the stage.
    pub path: String,
    sites: Vec<Site>,
}

impl Composed {
    fn specs(&self) -> impl Iterator<Item = &Spec> {
        self.sites.iter().flat_map(|s| &s.specs)
    }

    /// The last part of the path.
    #[must_use]
    pub fn name(&self) -> &str {
        self.path.rsplit('/').next().unwrap_or_default()
    }

    /// Whether a layer defines it, rather than speaking of it or keeping it to inherit from.
    #[must_use]
    pub fn is_defined(&self) -> bool {
        let mut said = self.specs().map(|s| s.prim.specifier);
        said.find(|s| *s != Specifier::Over) == Some(Specifier::Def)
    }

    /// Its type, empty if none is stated.
    #[must_use]
    pub fn kind(&self) -> &str {
        let mut kinds = self.specs().map(|s| s.prim.kind.as_str());
        kinds.find(|k| !k.is_empty()).unwrap_or_default()
    }

    /// A property's strongest value.
    #[must_use]
    pub fn value(&self, name: &str) -> Option<&Value> {
        let value = self.specs().find_map(|s| s.prim.properties.get(name))?;
        // "None" takes away what weaker opinions say
        (value.text() != Some("None")).then_some(value)
    }

    /// All numbers of a property, none if it is not stated.
    #[must_use]
    pub fn numbers(&self, name: &str) -> Vec<f64> {
        let mut list = Vec::new();
        if let Some(value) = self.value(name) {
            value.numbers(&mut list);
        }
        list
    }

    /// The strongest value of a key of metadata.
    #[must_use]
    pub fn metadata(&self, key: &str) -> Option<&Value> {
        self.specs().find_map(|s| s.prim.metadata.get(key))
    }

    /// Whether a property of it changes in time.
    #[must_use]
    pub fn is_sampled(&self) -> bool {
        self.specs().any(|s| !s.prim.sampled.is_empty())
    }

    /// Paths on the stage that a relationship names.
    #[must_use]
    pub fn targets(&self, name: &str) -> Vec<String> {
        let stated = |site: &Site| {
            let value = (site.specs.iter()).find_map(|s| s.prim.properties.get(name))?;
            let list = value.edits().applied_to(Vec::new());
            let path = |v: &Value| match v {
                Value::Target(t) => Some(site.moved(&t.prim)),
                _ => None,
            };
            Some(list.iter().filter_map(path).collect())
        };
        self.sites.iter().find_map(stated).unwrap_or_default()
    }
}

/// The composed scene.
pub struct Stage {
    files: Files,
    stacks: RefCell<BTreeMap<String, Rc<Stack>>>,
    /// Sites made so far.
    sites: Cell<usize>,
}

impl Stage {
    /// Opens a file.
    ///
    /// # Errors
    /// A file that cannot be read.
    pub fn open(file: &Path) -> Result<Self> {
        Ok(Self {
            files: Files::open(file)?,
            stacks: RefCell::default(),
            sites: Cell::new(0),
        })
    }

    /// A key of the whole stage's metadata, which the first layer states alone.
    ///
    /// # Errors
    /// A layer that cannot be read.
    pub fn metadata(&self, key: &str) -> Result<Option<Value>> {
        let stack = self.stack(&self.files.root)?;
        Ok(stack.layers[0].root.metadata.get(key).cloned())
    }

    /// The root of all prims.
    ///
    /// # Errors
    /// A layer that cannot be read.
    pub fn root(&self) -> Result<Composed> {
        Ok(Composed {
            path: String::new(),
            sites: vec![self.top(&self.stack(&self.files.root)?, 0)],
        })
    }

    /// The prims below `parent`, in the order in which layers speak of them, the weakest first.
    ///
    /// # Errors
    /// A reference that leads nowhere or in a circle.
    pub fn children(&self, parent: &Composed) -> Result<Vec<Composed>> {
        let mut order: Vec<&str> = Vec::new();
        let mut found: BTreeMap<&str, BTreeMap<usize, Vec<Spec>>> = BTreeMap::new();
        for (i, site) in parent.sites.iter().enumerate().rev() {
            for spec in site.specs.iter().rev() {
                for child in &spec.prim.children {
                    let of_name = found.entry(&child.name).or_default();
                    if of_name.is_empty() {
                        order.push(&child.name);
                    }
                    of_name.entry(i).or_default().push(Spec {
                        prim: Rc::clone(child),
                        layer: spec.layer,
                    });
                }
            }
        }
        let mut children = Vec::with_capacity(order.len());
        for name in order {
            let (mut sites, mut choices) = (Vec::new(), Choices::new());
            for (i, mut specs) in found.remove(name).unwrap_or_default() {
                specs.reverse();
                if let Some(site) = parent.sites[i].with_specs(name, specs) {
                    self.expand(site, &mut choices, &mut sites)?;
                }
            }
            children.push(Composed {
                path: format!("{}/{name}", parent.path),
                sites,
            });
        }
        Ok(children)
    }

    /// The prim at a path of the stage, if there is one.
    ///
    /// # Errors
    /// A reference that leads nowhere or in a circle.
    pub fn prim_at(&self, path: &str) -> Result<Option<Composed>> {
        let top = self.top(&self.stack(&self.files.root)?, 0);
        let sites = self.sites_at(top, path, &mut Choices::new())?;
        Ok((!sites.is_empty()).then(|| Composed {
            path: path.into(),
            sites,
        }))
    }

    fn top(&self, stack: &Rc<Stack>, arcs: usize) -> Site {
        let specs = (stack.layers.iter().enumerate()).map(|(layer, l)| Spec {
            prim: Rc::clone(&l.root),
            layer,
        });
        Site {
            specs: specs.collect(),
            stack: Rc::clone(stack),
            path: String::new(),
            moves: Vec::new(),
            arcs,
        }
    }

    fn sites_at(&self, top: Site, path: &str, choices: &mut Choices) -> Result<Vec<Site>> {
        let mut sites = vec![top];
        let mut names = path.split('/').filter(|n| !n.is_empty()).peekable();
        while let Some(name) = names.next() {
            let (mut below, mut of_parents) = (Vec::new(), Choices::new());
            // what a reference selects is meant for its target
            let choices = match names.peek() {
                Some(_) => &mut of_parents,
                None => &mut *choices,
            };
            for site in sites.iter().filter_map(|s| s.child(name)) {
                self.expand(site, choices, &mut below)?;
            }
            sites = below;
        }
        Ok(sites)
    }

    /// A site, and behind it those that its references and the like lead to.
    fn expand(&self, site: Site, choices: &mut Choices, out: &mut Vec<Site>) -> Result<()> {
        let layer = || &site.stack.layers[0].path;
        if site.arcs > DEEPEST {
            return Err(self.fail(layer(), &site.path, "references run in a circle"));
        }
        self.sites.set(self.sites.get() + 1);
        if self.sites.get() > MOST_SITES || out.len() > MOST_SITES_OF_PRIM {
            let most = format!(
                "more than {MOST_SITES} opinions in all or {MOST_SITES_OF_PRIM} of one prim; simplify the model"
            );
            return Err(self.fail(layer(), &site.path, &most));
        }
        for spec in &site.specs {
            if let Some(Value::Map(chosen)) = spec.prim.metadata.get("variants") {
                let chosen = chosen.iter().filter_map(|(k, v)| Some((k, v.text()?)));
                for (set, variant) in chosen {
                    choices.entry(set.clone()).or_insert(variant.into());
                }
            }
        }
        out.push(site.clone());
        self.follow(&site, "inherits", choices, out)?;
        for variant in site.variants(choices) {
            self.expand(variant, choices, out)?;
        }
        for kind in ["references", "payload", "specializes"] {
            self.follow(&site, kind, choices, out)?;
        }
        Ok(())
    }

    fn follow(
        &self,
        site: &Site,
        kind: &str,
        choices: &mut Choices,
        out: &mut Vec<Site>,
    ) -> Result<()> {
        for target in site.targets(kind) {
            let own = || Ok(Rc::clone(&site.stack));
            let stack = match target.asset.as_str() {
                "" => own(),
                path => self.stack(path),
            }?;
            let path = match target.prim.as_str() {
                "" => default_prim(&stack),
                path => path.to_owned(),
            };
            let found = self.sites_at(self.top(&stack, site.arcs + 1), &path, choices)?;
            // a class may well be missing, what is referred to may not
            if found.is_empty() && ["references", "payload"].contains(&kind) {
                let from = &stack.layers[0].path;
                let missing = format!("{kind}: {from} has no prim {path}; export the room again");
                return Err(self.fail(&site.stack.layers[0].path, &site.path, &missing));
            }
            let step = Rc::new(Move {
                from: path,
                to: site.path.clone(),
            });
            for mut found in found {
                found.moves.push(Rc::clone(&step));
                found.moves.extend(site.moves.iter().cloned());
                out.push(found);
            }
        }
        Ok(())
    }

    fn fail(&self, layer: &str, path: &str, message: &str) -> Error {
        Error::input(&self.files.file, format!("{layer}, prim {path}: {message}"))
    }

    fn stack(&self, path: &str) -> Result<Rc<Stack>> {
        if let Some(stack) = self.stacks.borrow().get(path) {
            return Ok(Rc::clone(stack));
        }
        let mut layers = Vec::new();
        self.gather(path, &mut Vec::new(), &mut layers)?;
        let stack = Rc::new(Stack { layers });
        let mut stacks = self.stacks.borrow_mut();
        stacks.insert(path.into(), Rc::clone(&stack));
        Ok(stack)
    }

    /// A layer, then its sublayers; `within` are those that it is a sublayer of.
    fn gather(&self, path: &str, within: &mut Vec<String>, into: &mut Vec<Layer>) -> Result<()> {
        if within.iter().any(|w| w == path) {
            return Err(Error::input(
                &self.files.file,
                format!("{path}: sublayers run in a circle"),
            ));
        }
        if into.iter().any(|l| l.path == path) {
            return Ok(());
        }
        let root = Rc::new(self.files.layer(path)?);
        into.push(Layer {
            path: path.into(),
            root: Rc::clone(&root),
        });
        within.push(path.into());
        for value in root.metadata.get("subLayers").map_or(&[][..], Value::list) {
            let asset = match value {
                Value::Target(t) => &t.asset,
                Value::Text(asset) => asset,
                _ => continue,
            };
            self.gather(&relative(path, asset), within, into)?;
        }
        within.pop();
        Ok(())
    }
}

/// The prim that references to a whole layer mean: the stated one or the first.
fn default_prim(stack: &Stack) -> String {
    let root = &stack.layers[0].root;
    let stated = root.metadata.get("defaultPrim").and_then(Value::text);
    let first = || root.children.first().map(|c| c.name.as_str());
    let name = stated.or_else(first).unwrap_or_default();
    format!("/{}", name.trim_start_matches('/'))
}
