"""One file per kind of anatomy: limits, seeds and checks that its CT calls for."""
