"""Write the module of `cablequad.proto`: `python -m logs.schema.generate [FOLDER]` (needs grpcio-tools)."""

import sys
from pathlib import Path

HERE = Path(__file__).parent


def generate(folder: Path) -> None:
    """`cablequad_pb2.py` and its type stub, into `folder`."""
    from grpc_tools import protoc

    arguments = ["protoc", f"-I{HERE}", f"--python_out={folder}", f"--pyi_out={folder}", str(HERE / "cablequad.proto")]
    if protoc.main(arguments) != 0:
        raise SystemExit("protoc failed")


if __name__ == "__main__":
    generate(Path(sys.argv[1]) if len(sys.argv) > 1 else HERE)
