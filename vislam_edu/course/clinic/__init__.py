"""The clinic of chapter 14: patients with an unlabelled fault, the tests that find it, an examination."""
