//! The few pickle instructions that `torch.save` uses for tables of tensors, and nothing else.
//!
//! A pickle is a program for a stack machine that may name any Python function. Here names stay names: nothing is
//! called. Values share their parts ([`Rc`]), so a hostile program takes no more memory than it has bytes (times a
//! constant), and the depth of nesting is bounded.
//!
//! Source: the description of the opcodes in Python's `pickletools`.

use std::collections::HashMap;
use std::rc::Rc;

/// Deeper nesting than any table of tensors has.
const MAX_DEPTH: usize = 32;
/// Larger programs are refused: that of XFeat has 19 kB.
const MAX_PROGRAM_BYTES: usize = 4 << 20;

/// A value of the program.
#[derive(Debug)]
pub(super) enum Value {
    None,
    Bool,
    Int(i64),
    Text(String),
    /// A Python function or class: module and name.
    Name(String, String),
    Tuple(Vec<Rc<Value>>),
    Dict(Vec<(Rc<Value>, Rc<Value>)>),
    /// A function applied to its arguments.
    Call(Rc<Value>, Rc<Value>),
    /// Something kept outside the pickle.
    Persistent(Rc<Value>),
}

/// What is wrong with a pickle.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub(super) enum PickleError {
    #[error("it ends in the middle of an instruction")]
    Truncated,
    #[error("instruction {0:#04x} has no place in a table of tensors")]
    Instruction(u8),
    #[error("an instruction finds other values on the stack than it needs")]
    Stack,
    #[error("it is nested too deeply")]
    Depth,
    #[error("it is too large")]
    TooLarge,
}

/// Runs the program and returns what it leaves.
pub(super) fn load(program: &[u8]) -> Result<Rc<Value>, PickleError> {
    if program.len() > MAX_PROGRAM_BYTES {
        return Err(PickleError::TooLarge);
    }
    Machine { rest: program, stack: Vec::new(), marks: Vec::new(), memo: HashMap::new() }.run()
}

/// A value with the depth of its nesting.
#[derive(Clone)]
struct Slot {
    value: Rc<Value>,
    depth: usize,
}

struct Machine<'a> {
    rest: &'a [u8],
    stack: Vec<Slot>,
    marks: Vec<usize>,
    memo: HashMap<u32, Slot>,
}

impl Machine<'_> {
    fn run(mut self) -> Result<Rc<Value>, PickleError> {
        loop {
            let [opcode] = self.take()?;
            match opcode {
                b'.' => return self.pop().map(|slot| slot.value),
                0x80 => {
                    let [_version] = self.take()?;
                }
                b'N' => self.push(Value::None, 0)?,
                0x88 | 0x89 => self.push(Value::Bool, 0)?,
                b'J' => {
                    let number = i32::from_le_bytes(self.take()?);
                    self.push(Value::Int(number.into()), 0)?;
                }
                b'K' => {
                    let [number] = self.take()?;
                    self.push(Value::Int(number.into()), 0)?;
                }
                b'M' => {
                    let number = u16::from_le_bytes(self.take()?);
                    self.push(Value::Int(number.into()), 0)?;
                }
                b'X' => self.text()?,
                b'c' => {
                    let name = Value::Name(self.line()?, self.line()?);
                    self.push(name, 0)?;
                }
                b'q' => {
                    let [key] = self.take()?;
                    self.remember(key.into())?;
                }
                b'r' => {
                    let key = u32::from_le_bytes(self.take()?);
                    self.remember(key)?;
                }
                b'h' => {
                    let [key] = self.take()?;
                    self.recall(key.into())?;
                }
                b'j' => {
                    let key = u32::from_le_bytes(self.take()?);
                    self.recall(key)?;
                }
                b'(' => self.marks.push(self.stack.len()),
                b')' => self.push(Value::Tuple(Vec::new()), 0)?,
                b't' => {
                    let mark = self.marks.pop().ok_or(PickleError::Stack)?;
                    self.tuple(mark)?;
                }
                0x85..=0x87 => {
                    let mark = self.stack.len().checked_sub(usize::from(opcode - 0x84));
                    self.tuple(mark.ok_or(PickleError::Stack)?)?;
                }
                b'}' => self.push(Value::Dict(Vec::new()), 0)?,
                b's' => {
                    let mark = self.stack.len().checked_sub(2).ok_or(PickleError::Stack)?;
                    self.set_items(mark)?;
                }
                b'u' => {
                    let mark = self.marks.pop().ok_or(PickleError::Stack)?;
                    self.set_items(mark)?;
                }
                b'Q' => {
                    let id = self.pop()?;
                    self.push(Value::Persistent(id.value), id.depth)?;
                }
                b'R' => self.call()?,
                // Attributes of an object: torch keeps version numbers there.
                b'b' => {
                    self.pop()?;
                }
                other => return Err(PickleError::Instruction(other)),
            }
        }
    }

    fn take<const N: usize>(&mut self) -> Result<[u8; N], PickleError> {
        let (bytes, rest) = self.rest.split_first_chunk::<N>().ok_or(PickleError::Truncated)?;
        self.rest = rest;
        Ok(*bytes)
    }

    fn text(&mut self) -> Result<(), PickleError> {
        let length = u32::from_le_bytes(self.take()?) as usize;
        let (bytes, rest) = self.rest.split_at_checked(length).ok_or(PickleError::Truncated)?;
        self.rest = rest;
        self.push(Value::Text(String::from_utf8_lossy(bytes).into_owned()), 0)
    }

    fn line(&mut self) -> Result<String, PickleError> {
        let end = self.rest.iter().position(|&byte| byte == b'\n').ok_or(PickleError::Truncated)?;
        let line = String::from_utf8_lossy(&self.rest[..end]).into_owned();
        self.rest = &self.rest[end + 1..];
        Ok(line)
    }

    /// Pushes a value whose deepest part has `depth`.
    fn push(&mut self, value: Value, depth: usize) -> Result<(), PickleError> {
        if depth >= MAX_DEPTH {
            return Err(PickleError::Depth);
        }
        self.stack.push(Slot { value: Rc::new(value), depth: depth + 1 });
        Ok(())
    }

    fn pop(&mut self) -> Result<Slot, PickleError> {
        self.stack.pop().ok_or(PickleError::Stack)
    }

    fn above(&mut self, mark: usize) -> Result<Vec<Slot>, PickleError> {
        if mark > self.stack.len() { Err(PickleError::Stack) } else { Ok(self.stack.split_off(mark)) }
    }

    fn remember(&mut self, key: u32) -> Result<(), PickleError> {
        let top = self.stack.last().ok_or(PickleError::Stack)?;
        self.memo.insert(key, top.clone());
        Ok(())
    }

    fn recall(&mut self, key: u32) -> Result<(), PickleError> {
        self.stack.push(self.memo.get(&key).ok_or(PickleError::Stack)?.clone());
        Ok(())
    }

    fn tuple(&mut self, mark: usize) -> Result<(), PickleError> {
        let parts = self.above(mark)?;
        let depth = parts.iter().map(|slot| slot.depth).max().unwrap_or(0);
        self.push(Value::Tuple(parts.into_iter().map(|slot| slot.value).collect()), depth)
    }

    /// Adds the pairs above `mark` to the table below them. Copies of the table in the memo stay as they were.
    fn set_items(&mut self, mark: usize) -> Result<(), PickleError> {
        let parts = self.above(mark)?;
        let table = self.pop()?;
        // A table shared with the memo is empty as `torch.save` writes it; copying a full one again and again
        // would take quadratic time.
        let mut items = match Rc::try_unwrap(table.value) {
            Ok(Value::Dict(items)) => items,
            Err(shared) if matches!(&*shared, Value::Dict(items) if items.is_empty()) => Vec::new(),
            _ => return Err(PickleError::Stack),
        };
        let (pairs, rest) = parts.as_chunks::<2>();
        if !rest.is_empty() {
            return Err(PickleError::Stack);
        }
        let depth = parts.iter().map(|slot| slot.depth).chain([table.depth - 1]).max().unwrap_or(0);
        items.extend(pairs.iter().map(|[key, value]| (Rc::clone(&key.value), Rc::clone(&value.value))));
        self.push(Value::Dict(items), depth)
    }

    fn call(&mut self) -> Result<(), PickleError> {
        let arguments = self.pop()?;
        let function = self.pop()?;
        let is_table = matches!(&*function.value, Value::Name(module, name)
            if module == "collections" && name == "OrderedDict");
        if is_table {
            return self.push(Value::Dict(Vec::new()), 0);
        }
        self.push(Value::Call(function.value, arguments.value), function.depth.max(arguments.depth))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_program_that_is_cut_anywhere_is_an_error() {
        // {"a": (1, 300)} as Python 3 writes it with protocol 2.
        let program = b"\x80\x02}q\x00X\x01\x00\x00\x00aq\x01K\x01M\x2c\x01\x86q\x02s.";
        let Value::Dict(items) = &*load(program).unwrap() else { panic!("no table") };
        assert!(matches!(&*items[0].0, Value::Text(text) if text == "a"));
        assert!(matches!(&*items[0].1, Value::Tuple(parts) if matches!(*parts[1], Value::Int(300))));
        for end in 0..program.len() {
            assert!(load(&program[..end]).is_err(), "{end} bytes");
        }
    }

    #[test]
    fn a_tuple_doubled_a_thousand_times_takes_no_memory() {
        let mut program = b"K\x01".to_vec();
        for _ in 0..1000 {
            program.extend_from_slice(b"q\x00h\x00\x86");
        }
        program.push(b'.');
        assert_eq!(load(&program).unwrap_err(), PickleError::Depth);
    }

    #[test]
    fn functions_are_not_called_and_other_instructions_are_refused() {
        let system = b"cos\nsystem\nX\x02\x00\x00\x00ls\x85R.";
        assert!(matches!(&*load(system).unwrap(), Value::Call(..)));
        assert_eq!(load(b"i.").unwrap_err(), PickleError::Instruction(b'i'));
    }

    #[test]
    fn instructions_without_their_values_are_errors() {
        for program in
            [b".".as_slice(), b"t.", b"s.", b"u.", b"R.", b"Q.", b"b.", b"q\x00.", b"h\x07.", b"\x87."]
        {
            assert_eq!(load(program).unwrap_err(), PickleError::Stack, "{program:?}");
        }
        // A mark above what is left of the stack.
        assert_eq!(load(b"K\x01K\x01(\x86t.").map(|_| ()), Err(PickleError::Stack));
    }
}
