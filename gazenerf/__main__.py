"""`python -m gazenerf`: the command line."""

from gazenerf.cli.main import main

raise SystemExit(main())
