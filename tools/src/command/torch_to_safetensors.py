# Converts a state dict of PyTorch (argument: the file) to safetensors (standard output), without PyTorch.
import collections, json, pickle, sys, zipfile

archive = zipfile.ZipFile(sys.argv[1])
root = next(name for name in archive.namelist() if name.endswith("/data.pkl"))[: -len("data.pkl")]


class Tensors(pickle.Unpickler):
    """Reads tensors as (dtype, shape, bytes). Any other function or class is an error."""

    def find_class(self, module, name):
        rebuild = lambda storage, offset, shape, *rest: (storage[0], shape, storage[1])
        return {
            ("collections", "OrderedDict"): collections.OrderedDict,
            ("torch._utils", "_rebuild_tensor_v2"): rebuild,
            ("torch", "FloatStorage"): "F32",
            ("torch", "LongStorage"): "I64",
        }[module, name]

    def persistent_load(self, key):
        return key[1], archive.read(root + "data/" + key[2])


header, data = {}, b""
for name, (dtype, shape, numbers) in sorted(Tensors(archive.open(root + "data.pkl")).load().items()):
    if dtype == "F32":
        header[name] = {"dtype": dtype, "shape": shape, "data_offsets": [len(data), len(data) + len(numbers)]}
        data += numbers
header = json.dumps(header, separators=(",", ":")).encode()
header += b" " * (-len(header) % 8)
sys.stdout.buffer.write(len(header).to_bytes(8, "little") + header + data)
