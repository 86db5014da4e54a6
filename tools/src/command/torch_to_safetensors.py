# Converts a state dict of PyTorch (argument: the file) to safetensors (standard output), without PyTorch.
# Both formats are read: zip archives, and the pickles one after the other of PyTorch before 1.6.
import collections, json, pickle, struct, sys, zipfile


class Tensors(pickle.Unpickler):
    """Reads tensors as (dtype, shape, first number, key of the storage). Any other function or class is an error."""

    def find_class(self, module, name):
        def rebuild(storage, first, shape, *rest):
            return (storage[0], shape, first, storage[1])

        return {
            ("collections", "OrderedDict"): collections.OrderedDict,
            ("torch._utils", "_rebuild_tensor_v2"): rebuild,
            ("torch", "FloatStorage"): "F32",
            ("torch", "LongStorage"): "I64",
            ("torch.cuda", "FloatStorage"): "F32",
            ("torch.cuda", "LongStorage"): "I64",
        }[module, name]

    def persistent_load(self, key):
        return key[1], key[2]


def read(path):
    """The object in the file, and the bytes of each storage."""
    if zipfile.is_zipfile(path):
        archive = zipfile.ZipFile(path)
        root = next(name for name in archive.namelist() if name.endswith("/data.pkl"))[: -len("data.pkl")]
        tensors = Tensors(archive.open(root + "data.pkl")).load()
        return tensors, lambda key: archive.read(root + "data/" + key)
    with open(path, "rb") as file:
        for header in ("magic number", "version", "machine"):
            Tensors(file).load()
        tensors = Tensors(file).load()
        types = {value[3]: value[0] for value in state_dict(tensors).values()}
        storages = {}
        for key in Tensors(file).load():
            (count,) = struct.unpack("<q", file.read(8))
            storages[key] = file.read(count * (8 if types.get(key) == "I64" else 4))
        return tensors, storages.__getitem__


def state_dict(tensors):
    """The tensors by name; those of a training's checkpoint are one level down, with a prefix."""
    tensors = tensors.get("state_dict", tensors)
    return {name[len("module.") :] if name.startswith("module.") else name: value for name, value in tensors.items()}


tensors, bytes_of = read(sys.argv[1])
header, data = {}, b""
for name, (dtype, shape, first, key) in sorted(state_dict(tensors).items()):
    if dtype == "F32":
        count = 1
        for size in shape:
            count *= size
        numbers = bytes_of(key)[4 * first : 4 * (first + count)]
        header[name] = {"dtype": dtype, "shape": shape, "data_offsets": [len(data), len(data) + len(numbers)]}
        data += numbers
header = json.dumps(header, separators=(",", ":")).encode()
header += b" " * (-len(header) % 8)
sys.stdout.buffer.write(len(header).to_bytes(8, "little") + header + data)
