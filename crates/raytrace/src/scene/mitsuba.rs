//! Scenes of Mitsuba 3 and Sionna RT: an XML file with meshes and radio materials.

mod limits;
mod materials;

use super::room::{Finish, Object};
use crate::material::Material;
use crate::mesh::MOST_TRIANGLES;
use glam::{DAffine3, DMat3, DMat4, DVec3};
use limits::{LONGEST, check_tags, expand_variables};
use pwrfgs_core::messages::{quoted, strip_control};
use pwrfgs_core::{Error, Result, files};
use roxmltree::{Document, Node};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Display;
use std::path::{Path, PathBuf};

/// Largest XML file, bytes.
const MOST_BYTES: u64 = 8 << 20;
/// Largest number of shapes; each is a file.
const MOST_SHAPES: usize = 5_000;
/// Largest number of variables.
const MOST_VARIABLES: usize = 100;
/// Shapes, which are read last, and elements of optical images, which are ignored.
const SUPPORTED: [&str; 9] =
    ["shape", "integrator", "sensor", "emitter", "film", "sampler", "rfilter", "texture", "medium"];

/// Contents of a Mitsuba file.
#[derive(Debug, Default)]
pub(crate) struct MitsubaScene {
    /// One mesh per shape.
    pub(crate) objects: Vec<Object>,
    /// Materials of type `radio-material`, by id.
    pub(crate) materials: BTreeMap<String, Material>,
}

impl MitsubaScene {
    /// Reads the shapes of an XML file and the materials that they use; paths of meshes become relative to the current
    /// directory. `scene_materials` are names of materials of the scene file, which have precedence.
    ///
    /// # Errors
    /// The file cannot be read, is not valid XML, has an element or material that is not supported, or names a missing
    /// mesh; the message has line and column.
    pub(crate) fn read<'s>(path: &Path, scene_materials: impl Iterator<Item = &'s String>) -> Result<Self> {
        let text = files::read_text_at_most(path, MOST_BYTES)?;
        check_tags(path, &text)?;
        let document = Document::parse(&text).map_err(|e| {
            let (row, column) = (e.pos().row as usize, e.pos().col as usize);
            Error::at(
                path,
                row,
                column,
                format!("invalid XML: {}; export the scene again", strip_control(&e.to_string())),
            )
        })?;
        let scene_materials = scene_materials.map(String::as_str).collect();
        let (variables, materials, finishes) = Default::default();
        Reader { path, document: &document, scene_materials, variables, materials, finishes }.read_scene()
    }

    /// Returns default positions of the antennas from the size of the meshes, metres: receiver, and smallest and largest
    /// transmitter position.
    ///
    /// # Errors
    /// A mesh that cannot be read, too many triangles, or a single wall.
    pub(crate) fn default_antennas(&self) -> Result<[[f64; 3]; 3]> {
        let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        let mut triangles = 0;
        for object in &self.objects {
            let mesh = object.placed_mesh(false)?;
            triangles += mesh.triangles.len();
            if triangles > MOST_TRIANGLES {
                let advice = "triangles, a mesh counted once per shape; simplify the meshes";
                return Err(Error::Config(format!("the shapes have more than {MOST_TRIANGLES} {advice}")));
            }
            for vertex in mesh.vertices {
                (low, high) = (low.min(vertex), high.max(vertex));
            }
        }
        if (high.x - low.x).min(high.y - low.y) < 1e-6 {
            let problem = "a single wall has no default antennas; name the XML file in a scene file, as `mitsuba`";
            return Err(Error::Config(problem.into()));
        }
        // Heights of people, or the middle of anything lower except bare ground; multiples of 0.1 mm, as transmitters are.
        let height = if high.z - low.z > 0.01 { (0.5 * (high.z - low.z)).min(1.5) } else { 1.5 };
        let round = |point: DVec3| point.to_array().map(|v| (v * 1e4).round() / 1e4);
        let middle = (0.5 * (low + high)).with_z(low.z + height);
        // Transmitters keep a tenth of the size from the outermost walls.
        let reach = 0.4 * (high - low).with_z(0.0);
        Ok([middle, middle - reach, middle + reach].map(round))
    }
}

/// State of the parser.
struct Reader<'a> {
    path: &'a Path,
    document: &'a Document<'a>,
    /// Names of the materials of the scene file.
    scene_materials: BTreeSet<&'a str>,
    /// Values of `<default>`, inserted for `$name`.
    variables: BTreeMap<&'a str, &'a str>,
    /// Elements of materials, by id and alias.
    materials: BTreeMap<String, Element<'a>>,
    /// Finishes of the materials read so far, by id.
    finishes: BTreeMap<String, Finish>,
}

type Element<'a> = Node<'a, 'a>;

/// Returns the child elements of a node.
fn child_elements(node: Element<'_>) -> impl Iterator<Item = Element<'_>> {
    node.children().filter(Node::is_element)
}

/// Returns the first child element whose attribute `name` has this value; `None` if there is none.
fn property_element<'a>(node: Element<'a>, name: &str) -> Option<Element<'a>> {
    child_elements(node).find(|child| child.attribute("name") == Some(name))
}

impl<'a> Reader<'a> {
    /// Returns the error `problem` with line and column of an element.
    fn fault(&self, node: Element<'_>, problem: impl Display) -> Error {
        let pos = self.document.text_pos_at(node.range().start);
        Error::at(self.path, pos.row as usize, pos.col as usize, problem)
    }

    /// Returns the error `problem` at `node` unless `holds`.
    fn require(&self, holds: bool, node: Element<'_>, problem: impl Display) -> Result<()> {
        if holds { Ok(()) } else { Err(self.fault(node, problem)) }
    }

    /// Reads the whole scene: variables and materials first, then shapes. Returns an error for an unsupported or invalid
    /// element.
    fn read_scene(&mut self) -> Result<MitsubaScene> {
        let root = self.document.root_element();
        let problem = "this is not a Mitsuba scene; give a file whose first element is `scene`";
        self.require(root.has_tag_name("scene"), root, problem)?;
        let mut scene = MitsubaScene::default();
        for node in child_elements(root) {
            match node.tag_name().name() {
                "default" => self.read_variable(node)?,
                "bsdf" => self.declare_material(node, &mut scene)?,
                "alias" => {
                    // A use of an alias of no material reports it as unknown.
                    let [id, alias] = ["id", "as"].map(|name| self.required_attribute(node, name));
                    let named = self.materials.get(&id?).copied();
                    self.materials.extend(named.map(|node| alias.map(|alias| (alias, node))).transpose()?);
                }
                name => {
                    let problem = "put its shapes and materials into this file";
                    let problem = format!("unsupported element {}; {problem}", quoted(name));
                    self.require(SUPPORTED.contains(&name), node, problem)?;
                }
            }
        }
        for node in child_elements(root).filter(|node| node.has_tag_name("shape")) {
            let problem = "shapes; join the meshes of each material, or cut out a part";
            self.require(scene.objects.len() < MOST_SHAPES, node, format_args!("more than {MOST_SHAPES} {problem}"))?;
            let object = self.read_shape(node, &mut scene)?;
            scene.objects.push(object);
        }
        self.require(!scene.objects.is_empty(), root, "the scene has no `shape`; export its meshes too")?;
        Ok(scene)
    }

    /// Reads a `default` element and adds its variable to `variables`. Returns an error for an invalid one, or too many.
    fn read_variable(&mut self, node: Element<'a>) -> Result<()> {
        let pair = node.attribute("name").zip(node.attribute("value"));
        let pair = pair.filter(|(name, value)| !name.is_empty() && !value.contains('$') && value.len() <= LONGEST);
        let problem = "`default` needs a `name` and a short `value` without `$`; correct it";
        let problem = format!("{problem}, and give at most {MOST_VARIABLES}");
        self.require(pair.is_some() && self.variables.len() < MOST_VARIABLES, node, problem)?;
        self.variables.extend(pair);
        Ok(())
    }

    /// Returns the value of an attribute with variables replaced; `None` without the attribute. Returns an error for an
    /// unknown variable or a value that is too long.
    fn attribute(&self, node: Element<'_>, name: &str) -> Result<Option<String>> {
        let Some(value) = node.attribute(name) else { return Ok(None) };
        expand_variables(name, value, &self.variables).map(Some).map_err(|problem| self.fault(node, problem))
    }

    /// Returns the value of an attribute with variables replaced, or an error if it is missing.
    fn required_attribute(&self, node: Element<'_>, name: &str) -> Result<String> {
        let missing = || self.fault(node, format!("the element has no `{name}`; add it"));
        self.attribute(node, name)?.ok_or_else(missing)
    }

    /// Returns the numbers of an attribute, separated by commas or blanks; `None` without the attribute. Returns an error
    /// unless all are finite numbers.
    fn attribute_numbers(&self, node: Element<'_>, name: &str) -> Result<Option<Vec<f64>>> {
        let Some(text) = self.attribute(node, name)? else { return Ok(None) };
        let fields = text.split([',', ' ', '\t', '\n']).filter(|field| !field.is_empty());
        let number = |field: &str| field.parse::<f64>().ok().filter(|v| v.is_finite());
        let fault = |field| self.fault(node, format!("`{name}`: {} is not a finite number; correct it", quoted(field)));
        fields.map(|field| number(field).ok_or_else(|| fault(field))).collect::<Result<Vec<f64>>>().map(Some)
    }

    /// Returns the number of an attribute; `None` without the attribute. Returns an error unless it is one finite number.
    fn attribute_number(&self, node: Element<'_>, name: &str) -> Result<Option<f64>> {
        match self.attribute_numbers(node, name)?.as_deref() {
            None => Ok(None),
            Some(&[value]) => Ok(Some(value)),
            Some(_) => Err(self.fault(node, format!("`{name}` must be one number; correct it"))),
        }
    }

    /// Returns the number of the property `name` of a node; `None` without the property. Returns an error unless it lies
    /// between `low` and `high`.
    fn property_number(&self, node: Element<'_>, name: &str, low: f64, high: f64) -> Result<Option<f64>> {
        let Some(child) = property_element(node, name) else { return Ok(None) };
        let value = self.attribute_number(child, "value")?.filter(|value| (low..=high).contains(value));
        let fault = || self.fault(child, format!("`{name}` must be a number from {low} to {high}; correct it"));
        value.ok_or_else(fault).map(Some)
    }

    /// Reads a shape as an object with a hollow mesh, since antennas may be inside, and adds a material inside its element to
    /// `scene`. Returns an error for an unsupported shape or transform, or a missing mesh or material.
    fn read_shape(&mut self, node: Element<'a>, scene: &mut MitsubaScene) -> Result<Object> {
        let kind = self.required_attribute(node, "type")?;
        let name = self.attribute(node, "id")?.unwrap_or(format!("shape {}", scene.objects.len() + 1));
        let file = match &*kind {
            "ply" | "obj" => self.mesh_file(node)?,
            "cube" | "rectangle" => (&kind).into(),
            _ => {
                let problem = format!("unsupported shape type {}; export the shape as a PLY mesh", quoted(&kind));
                return Err(self.fault(node, problem));
            }
        };
        let finish = self.read_finish(node, scene)?;
        let mut matrix = None;
        for transform in child_elements(node).filter(|child| child.has_tag_name("transform")) {
            self.require(
                transform.attribute("name") == Some("to_world"),
                transform,
                "rename the transform `to_world`",
            )?;
            let [x, y, z, _] = DMat4::from(self.read_transform(transform)?).transpose().to_cols_array_2d();
            matrix = Some([x, y, z]);
        }
        Ok(Object::Mesh { name, file, matrix, scale: 1.0, yaw_deg: 0.0, shift: [0.0; 3], hollow: true, finish })
    }

    /// Returns the path of the mesh of a shape. Returns an error if it is missing.
    fn mesh_file(&self, node: Element<'_>) -> Result<PathBuf> {
        let source = property_element(node, "filename");
        let source = source.ok_or_else(|| self.fault(node, "a shape needs a `filename`; add the path of its mesh"))?;
        let stated = self.required_attribute(source, "value")?.replace('\\', "/");
        let file = self.path.parent().unwrap_or(Path::new("")).join(&stated);
        let problem =
            "is missing: paths begin in the folder of the XML file, so copy its meshes too, or correct the path";
        self.require(file.is_file(), source, format_args!("mesh {} {problem}", quoted(&stated)))?;
        Ok(file)
    }

    /// Reads a `transform` element as one map: its steps applied in order. Returns an error for an unsupported step or
    /// an invalid number.
    fn read_transform(&self, node: Element<'_>) -> Result<DAffine3> {
        let mut combined = DAffine3::IDENTITY;
        for step in child_elements(node) {
            let fault = |problem: &str| self.fault(step, problem);
            let next = match step.tag_name().name() {
                "translate" => DAffine3::from_translation(self.read_vector(step, 0.0)?),
                "scale" => DAffine3::from_scale(self.read_vector(step, 1.0)?),
                "rotate" => {
                    let (axis, angle) =
                        (self.read_vector(step, 0.0)?.try_normalize(), self.attribute_number(step, "angle")?);
                    let Some((axis, degrees)) = axis.zip(angle) else {
                        return Err(fault("`rotate` needs an axis x, y or z, and an `angle` in degrees"));
                    };
                    DAffine3::from_axis_angle(axis, degrees.to_radians())
                }
                "matrix" => match self.attribute_numbers(step, "value")?.as_deref() {
                    Some(rows @ [.., 0.0, 0.0, 0.0, 1.0]) if rows.len() == 16 => {
                        DAffine3::from_mat4(DMat4::from_cols_slice(rows).transpose())
                    }
                    Some(rows) if rows.len() == 9 => DAffine3::from_mat3(DMat3::from_cols_slice(rows).transpose()),
                    _ => {
                        return Err(fault(
                            "`matrix` needs 16 numbers, row by row, the last row 0 0 0 1, or 9 without translation",
                        ));
                    }
                },
                _ => return Err(fault("unsupported transform; use translate, scale, rotate or matrix")),
            };
            combined = next * combined;
        }
        Ok(combined)
    }

    /// Reads a vector from the attribute `value`, with one or three numbers, or from `x`, `y` and `z`, each with a default.
    /// Returns an error for other numbers.
    fn read_vector(&self, node: Element<'_>, default: f64) -> Result<DVec3> {
        match self.attribute_numbers(node, "value")?.as_deref() {
            Some(&[value]) => Ok(DVec3::splat(value)),
            Some(&[x, y, z]) => Ok(DVec3::new(x, y, z)),
            Some(_) => Err(self.fault(node, "`value` needs one number or three")),
            None => {
                let axis = |name| Ok(self.attribute_number(node, name)?.unwrap_or(default));
                Ok(DVec3::new(axis("x")?, axis("y")?, axis("z")?))
            }
        }
    }
}
